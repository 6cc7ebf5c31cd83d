"""COLON: ranges in a map whose walls have moved by an unknown distance, and how the walls are learned from them.

Ranges are read by B beams; beams are rows, particles columns. The walls are those of a reference map, with nodes along
them (``dynpf.colon.wall.Wall``); what belongs together comes as a tuple of ``dynpf.colon.evidence``.
"""

import numpy as np

from dynpf.kernels.colon import beam_density, normal_density
from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import log, sincos

__all__ = ["changed", "follow_walls"]

_f, _i = np.float32, np.int32
_ZERO, _ONE, _TWO = _f(0.0), _f(1.0), _f(2.0)
_NOWHERE = _i(-1)
_SLANT = _i(3)  # px over which the wall's slope is taken
_TINY, _LEAST_BLAME = _f(1e-30), _f(1e-3)


@device
def _between_cells(table, column, row):
    """Return a table's value between the middles of four cells, linearly."""
    left, below = np.floor(column), np.floor(row)
    c, r = _i(left), _i(below)
    right, above = column - left, row - below
    low = table[r, c] + right * (table[r, c + 1] - table[r, c])
    high = table[r + 1, c] + right * (table[r + 1, c + 1] - table[r + 1, c])
    return low + above * (high - low)


@device
def _inside(position, cells):
    """Return a position moved into the map, far enough from its edge to take a slope there.

    Of two numbers one of which is NaN, max returns the first: so it is within the map whatever the position.
    """
    return min(max(_f(_SLANT), position), _f(cells - _SLANT - 2))


@device
def _facing(beyond, c, r, sine, cosine):
    """Return the cosine of the angle between a beam and the wall's normal, by the slope of ``beyond`` at a cell."""
    along = beyond[r, c + _SLANT] - beyond[r, c - _SLANT]
    across = beyond[r + _SLANT, c] - beyond[r - _SLANT, c]
    slope = np.sqrt(along * along + across * across)
    return abs(along * cosine + across * sine) / max(slope, _ONE)


@device
def _between(of_one, of_next, share):
    """Return the value ``share`` of the way from one node to the next, linearly."""
    return (_ONE - share) * of_one + share * of_next


@device
def _node_variance(covariance, j, k, share):
    """Return the variance of the displacement between nodes j and k."""
    rest = _ONE - share
    return rest * rest * covariance[j, j] + _TWO * rest * share * covariance[j, k] + share * share * covariance[k, k]


@device
def _leave_out(stops, beam, i, rough):
    """Write the entries of a beam that carries no information about a wall."""
    stops.blame[beam, i] = _ZERO
    stops.distance[beam, i] = _ZERO
    stops.variance[beam, i] = rough
    stops.facing[beam, i] = _ZERO
    stops.unmoved[beam, i] = _ONE
    stops.node[beam, i] = _NOWHERE
    stops.share[beam, i] = _ZERO


@kernel
def changed(beams, walls, displacements, noise, out, stops):
    """Write the log-likelihood of ranges where the walls may have moved, to ``out`` (N,), and ``stops`` (Stops).

    ``beams``: Beams. ``walls``: a Wall. ``displacements``: Displacements of its nodes. ``noise``: a WallNoise.
    """
    x, y, theta = beams.x, beams.y, beams.theta
    angles, read, expected = beams.angles, beams.read, beams.expected
    beyond, node, share, following = walls.beyond, walls.node, walls.share, walls.following
    means, ancestors = displacements.means, displacements.ancestors
    covariance, chances = displacements.covariance, displacements.chances
    sigma, wide, outliers, range_max = _f(noise.sigma), _f(noise.wide), _f(noise.outliers), _f(noise.range_max)
    rough = _f(noise.roughness) * _f(noise.roughness)
    sensed = _f(noise.sigma_range) * _f(noise.sigma_range)
    height, width = beyond.shape
    out[:] = _ZERO
    for beam in range(read.size):
        z = read[beam]
        if not z < range_max:
            for i in range(out.size):
                _leave_out(stops, beam, i, rough)
                if not np.isnan(z):
                    unmoved = beam_density(expected[beam, i] - z, sigma, wide, outliers, range_max)
                    stops.unmoved[beam, i] = unmoved
                    out[i] += log(unmoved)
            continue
        for i in range(out.size):
            sine, cosine = sincos(theta[i] + angles[beam])
            column, row = _inside(x[i] + z * cosine, width), _inside(y[i] + z * sine, height)
            c, r = _i(np.rint(column)), _i(np.rint(row))
            facing = _facing(beyond, c, r, sine, cosine)
            distance = _between_cells(beyond, column, row)
            j, f = node[r, c], share[r, c]
            k = following[j]
            chance = _between(chances[j], chances[k], f)
            across_wall = rough + facing * facing * sensed
            spread = np.sqrt(_node_variance(covariance, j, k, f) + across_wall)
            of = ancestors[i]
            error = distance - _between(means[of, j], means[of, k], f)
            stopped = chance * (_ONE - outliers) * facing * normal_density(error, spread)
            unmoved = beam_density(expected[beam, i] - z, sigma, wide, outliers, range_max)
            likelihood = stopped + (_ONE - chance) * unmoved + chance * outliers / range_max
            out[i] += log(likelihood)
            stops.blame[beam, i] = stopped / max(likelihood, _TINY)
            stops.distance[beam, i] = distance
            stops.variance[beam, i] = across_wall
            stops.facing[beam, i] = facing
            stops.unmoved[beam, i] = unmoved
            stops.node[beam, i] = j
            stops.share[beam, i] = f


@device
def _condition(covariance, observed, noise):
    """Condition a covariance (J, J), in place, on a sum ``observed`` (J,) of its variables, read with ``noise``."""
    nodes = observed.size
    cross = np.zeros(nodes)
    for j in range(nodes):
        if observed[j] != 0.0:
            for n in range(nodes):
                cross[n] += observed[j] * np.float64(covariance[j, n])
    variance = noise
    for n in range(nodes):
        variance += observed[n] * cross[n]
    for m in range(nodes):
        scaled = cross[m] / variance
        for n in range(nodes):
            covariance[m, n] = _f(np.float64(covariance[m, n]) - scaled * cross[n])


@kernel
def follow_walls(stops, following, weights, means, covariance, chances):
    """Update displacements (N, J), their covariance (J, J) and chances (J,), in place, by where beams were stopped.

    A Kalman update for each particle and beam, as FastSLAM's of a landmark (Montemerlo et al., 2002), the variance of
    where the beam was stopped divided by its blame. Covariance and chances are shared: they follow the mean over the
    particles, by ``weights`` (N,). ``stops``: Stops, ``following`` (J,): see Wall.
    """
    blame, distance, variance, node, share = stops.blame, stops.distance, stops.variance, stops.node, stops.share
    beams, count = blame.shape
    nodes = covariance.shape[0]
    total = 0.0
    for i in range(count):
        total += np.float64(weights[i])
    for beam in range(beams):
        seen = np.zeros(nodes)
        observed = np.zeros(nodes)
        blamed, noisy = 0.0, 0.0
        for i in range(count):
            j, f = node[beam, i], share[beam, i]
            if j >= _i(0):
                k = following[j]
                weight = np.float64(weights[i])
                part = weight * np.float64(blame[beam, i])
                blamed += part
                noisy += part * np.float64(variance[beam, i])
                seen[j] += weight * np.float64(_ONE - f)
                seen[k] += weight * np.float64(f)
                observed[j] += part * np.float64(_ONE - f)
                observed[k] += part * np.float64(f)
                if blame[beam, i] > _LEAST_BLAME:
                    moved = _between(means[i, j], means[i, k], f)
                    expected = _node_variance(covariance, j, k, f)
                    gain = (distance[beam, i] - moved) / (expected + variance[beam, i] / blame[beam, i])
                    at_j, at_k = gain * (_ONE - f), gain * f
                    for n in range(nodes):
                        means[i, n] += at_j * covariance[j, n] + at_k * covariance[k, n]
        for n in range(nodes):
            chances[n] = _f(np.float64(chances[n]) + (observed[n] - seen[n] * np.float64(chances[n])) / total)
        if blamed > np.float64(_LEAST_BLAME) * total:
            _condition(covariance, observed / blamed, noisy / blamed * total / blamed)
