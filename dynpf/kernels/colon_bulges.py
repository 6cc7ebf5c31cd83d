"""COLON: bulges, displacements of a wall that have one of some shapes, times an unknown height.

Shapes are those of a wall (``dynpf.colon.wall.Wall``), S in all; what is known of each particle's bulges is a
``dynpf.colon.evidence.Bulges``, which the kernels change in place.
"""

import numpy as np

from dynpf.kernels.colon import normal_density
from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import exp, log

__all__ = ["bulged", "bulges_given_way", "displaced"]

_f, _i = np.float32, np.int32
_ZERO, _HALF, _ONE = _f(0.0), _f(0.5), _f(1.0)
# Where a bulge reaches out by less than the first share of its height it is not there, by more than the second it is.
_LEAST_REACH, _OVER_FULL_REACH = _f(0.05), _f(4.0)
_FAR = _f(1e6)  # steep: beyond the least reach at once
_TINY, _LEAST_BLAME = _f(1e-30), _f(1e-3)


@device
def _updated(reach, height, variance, stopped_at, noise, facing, unmoved, nothing):
    """Return height and variance of a bulge after one beam, and the log of how much likelier it makes the bulge.

    A Kalman update, its noise divided by the blame; ``reach``: how much of the height the wall has moved there.
    """
    moved = min(max(reach - _LEAST_REACH, _ZERO) * _FAR, reach * _OVER_FULL_REACH)
    moved = min(moved, _ONE)
    explained = reach * reach * variance
    error = stopped_at - reach * height
    stopped = moved * facing * normal_density(error, np.sqrt(explained + noise))
    likelihood = stopped + (_ONE - moved) * unmoved + moved * nothing
    gained = log((likelihood + _TINY) / (unmoved + _TINY))
    blame = stopped / max(likelihood, _TINY)
    blame = blame if blame > _LEAST_BLAME else _ZERO
    gain = blame * reach * variance / (blame * explained + noise)
    return height + gain * error, variance * (_ONE - gain * reach), gained


@device
def _normalize(log_shapes, i, parts):
    """Normalize log-probabilities (N, S + 1) of particle i, with room for ``parts`` (S + 1,); return their log-sum."""
    count = parts.size
    most = log_shapes[i, 0]
    for s in range(count):
        most = max(most, log_shapes[i, s])
    for s in range(count):  # apart from the sum: so it vectorizes
        parts[s] = exp(log_shapes[i, s] - most)
    total = _ZERO
    for s in range(count):
        total += parts[s]
    evidence = most + log(total)
    for s in range(count):
        log_shapes[i, s] -= evidence
    return evidence


@kernel
def bulged(stops, walls, noise, shapeless, out, bulges):
    """Let ranges weigh ``bulges`` (Bulges), in place, and write the log-likelihood over all of them to ``out`` (N,).

    ``stops``: the Stops that ``colon_walls.changed`` found; ``walls``: a Wall; ``noise``: a WallNoise.
    ``shapeless`` (N,): the log-likelihood where the displacement has no such shape. Beams of one reading are taken in
    turn.
    """
    stopped_at, variances_at, facings = stops.distance, stops.variance, stops.facing
    unmoved, node, share = stops.unmoved, stops.node, stops.share
    following, shapes, near = walls.following, walls.shapes, walls.near
    log_shapes, heights, variances = bulges.log_shapes, bulges.heights, bulges.variances
    outliers, range_max = _f(noise.outliers), _f(noise.range_max)
    rough, nothing = _f(noise.bulge_roughness * noise.bulge_roughness), outliers / range_max
    beams, count = node.shape
    last, width = heights.shape[1], near.shape[1]
    parts = np.empty(last + 1, dtype=np.float32)
    reaches, height = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    variance, gained = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    for i in range(count):
        base = _ZERO
        for beam in range(beams):
            base += log(unmoved[beam, i])
        for beam in range(beams):
            j = node[beam, i]
            if j < _i(0):
                continue
            k, f = following[j], share[beam, i]
            for w in range(width):
                s = near[j, w]
                reaches[w] = (_ONE - f) * shapes[s, j] + f * shapes[s, k]
                height[w], variance[w] = heights[i, s], variances[i, s]
            facing = (_ONE - outliers) * facings[beam, i]
            at, noisy, as_before = stopped_at[beam, i], variances_at[beam, i] + rough, unmoved[beam, i]
            for w in range(width):  # apart from what is looked up: so it vectorizes
                height[w], variance[w], gained[w] = _updated(
                    reaches[w], height[w], variance[w], at, noisy, facing, as_before, nothing
                )
            for w in range(width):
                s = near[j, w]
                log_shapes[i, s] += gained[w]
                heights[i, s], variances[i, s] = height[w], variance[w]
        log_shapes[i, last] += shapeless[i] - base
        out[i] = base + _normalize(log_shapes, i, parts)


@kernel
def bulges_given_way(bulges, fresh, begun, height, variance, growth):
    """Mix ``bulges`` (Bulges), in place, with those that have just begun, of probability ``fresh`` (N,), by moments.

    ``begun`` (S + 1,): log-probabilities of those that begin, ``height`` and ``variance`` of each. ``growth``: variance
    by which every height also moves on.
    """
    log_shapes, heights, variances = bulges.log_shapes, bulges.heights, bulges.variances
    height, variance, growth = _f(height), _f(variance), _f(growth)
    count, last = heights.shape
    kept = np.empty(last + 1, dtype=np.float32)
    new = np.empty(last + 1, dtype=np.float32)
    for s in range(last + 1):
        new[s] = exp(begun[s])
    for i in range(count):
        stays = _ONE - fresh[i]
        for s in range(last + 1):
            old = stays * exp(log_shapes[i, s])
            mixed = old + fresh[i] * new[s] + _TINY
            kept[s] = old / mixed
            log_shapes[i, s] = log(mixed)
        for s in range(last):
            share = kept[s]
            off = heights[i, s] - height
            variances[i, s] = share * variances[i, s] + (_ONE - share) * (variance + share * (off * off)) + growth
            heights[i, s] = height + share * off


@kernel
def displaced(unlisted, bulges, means, chances, shapes, out):
    """Write how far nodes are expected to have moved where the walls are none that is listed, to ``out`` (J,).

    ``unlisted`` (N,): weights of particles there, float64. The sum of the displacement without a shape, ``means``
    (N, J), where a node has more likely moved than not by its ``chances`` (J,), and of the ``bulges`` (Bulges) of the
    ``shapes`` (S, J).
    """
    log_shapes, heights = bulges.log_shapes, bulges.heights
    count, last = heights.shape
    nodes = chances.size
    expected = np.zeros(last)
    for n in range(nodes):
        out[n] = 0.0
    for i in range(count):
        for s in range(last):
            expected[s] += unlisted[i] * np.float64(exp(log_shapes[i, s]) * heights[i, s])
        shapeless = unlisted[i] * np.float64(exp(log_shapes[i, last]))
        for n in range(nodes):
            out[n] += shapeless * np.float64(means[i, n])
    for n in range(nodes):
        out[n] = out[n] if chances[n] > _HALF else 0.0
    for s in range(last):
        for n in range(nodes):
            out[n] += expected[s] * np.float64(shapes[s, n])
