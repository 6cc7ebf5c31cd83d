"""COLON: how likely ranges are in a listed map, or in one whose walls have moved by nobody knows how much.

Ranges are read by B beams; beams are rows, particles columns. A range that is NaN tells nothing, and one at the cap
only that the wall is farther.
"""

import numpy as np

from dynpf.kernels.cloud import normalize
from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import exp, log, sincos

__all__ = [
    "bearable",
    "bulged",
    "bulges_given_way",
    "changed",
    "displaced",
    "follow_walls",
    "given_way",
    "listed",
    "weighed",
]

_f, _i = np.float32, np.int32
_ZERO, _HALF, _ONE, _TWO = _f(0.0), _f(0.5), _f(1.0), _f(2.0)
_ONE_OVER_ROOT_TWO_PI = _f(0.3989422804014327)
# Most ranges are as good as the noise says, a few are worse: near edges a small error of the pose is a large one of
# the range.
_WIDE_SHARE = _f(0.07)
_NOWHERE = _i(-1)
_SLANT = _i(3)  # px over which the wall's slope is taken
# Where a bulge reaches out by less than the first share of its height it is not there, by more than the second it is.
_LEAST_REACH, _OVER_FULL_REACH = _f(0.05), _f(4.0)
_FAR = _f(1e6)  # steep: beyond the least reach at once
_TINY, _LEAST_BLAME = _f(1e-30), _f(1e-3)
_IMPOSSIBLE = _f(-np.inf)
_HALVINGS = 16


@device
def normal_density(error, sigma):
    scaled = error / sigma
    return _ONE_OVER_ROOT_TWO_PI / sigma * exp(-_HALF * scaled * scaled)


@device
def beam_density(error, sigma, wide, outliers, range_max):
    narrow = (_ONE - _WIDE_SHARE - outliers) * normal_density(error, sigma)
    return narrow + _WIDE_SHARE * normal_density(error, wide) + outliers / range_max


@device
def between_cells(table, column, row):
    """Return a table's value between the middles of four cells, linearly."""
    left, below = np.floor(column), np.floor(row)
    c, r = _i(left), _i(below)
    right, above = column - left, row - below
    low = table[r, c] + right * (table[r, c + 1] - table[r, c])
    high = table[r + 1, c] + right * (table[r + 1, c + 1] - table[r + 1, c])
    return low + above * (high - low)


@device
def node_variance(covariance, j, k, share):
    """Return the variance of the displacement between nodes j and k."""
    rest = _ONE - share
    return rest * rest * covariance[j, j] + _TWO * rest * share * covariance[j, k] + share * share * covariance[k, k]


@device
def condition(covariance, observed, noise):
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
def listed(expected, read, sigma, wide, outliers, range_max, out):
    """Write the log-likelihood of ranges ``read`` (B,) where ``expected`` (B, N) are right, to ``out`` (N,)."""
    sigma, wide, outliers, range_max = _f(sigma), _f(wide), _f(outliers), _f(range_max)
    out[:] = _ZERO
    for beam in range(read.size):
        if not np.isnan(read[beam]):
            for i in range(out.size):
                out[i] += log(beam_density(expected[beam, i] - read[beam], sigma, wide, outliers, range_max))


@kernel
def changed(
    x,
    y,
    theta,
    angles,
    read,
    expected,
    beyond,
    node,
    share,
    following,
    displacement,
    ancestors,
    covariance,
    chances,
    sigma,
    wide,
    roughness,
    sigma_range,
    outliers,
    range_max,
    out,
    blame,
    stopped_at,
    noise,
    facings,
    still,
    places,
    shares,
):
    """Write the log-likelihood of ranges ``read`` (B,) where the walls may have moved, to ``out`` (N,).

    x, y in cells from the middle of cell (0, 0). ``expected`` (B, N): ranges in the reference map. ``beyond`` (H, W):
    how far a cell lies beyond the reference wall; ``node`` and ``share``: between which nodes of the wall it lies, and
    how far towards the one that follows. Displacements of nodes: means (M, J), of which ``ancestors`` (N,) tells each
    particle's, and one covariance (J, J). ``chances`` (J,): probabilities that nodes have moved at all.
    ``sigma``, ``wide``: of most ranges and of a few; ``roughness``: of where a wall is about what the nodes say;
    ``sigma_range``: of the sensor alone, which across a wall shrinks as the beam slants.

    For the update of the displacements, (B, N) each: ``blame``, the probability that a moved wall stopped the beam;
    ``stopped_at``, how far beyond the reference wall that was, and the variance of its ``noise``; ``places`` and
    ``shares``, between which nodes: the place -1 where a beam says nothing of a wall.
    """
    sigma, wide, outliers, range_max = _f(sigma), _f(wide), _f(outliers), _f(range_max)
    rough, sensed = _f(roughness) * _f(roughness), _f(sigma_range) * _f(sigma_range)
    height, width = beyond.shape
    out[:] = _ZERO
    for beam in range(read.size):
        z = read[beam]
        if not z < range_max:
            for i in range(out.size):
                blame[beam, i] = _ZERO
                stopped_at[beam, i] = _ZERO
                noise[beam, i] = rough
                facings[beam, i] = _ZERO
                still[beam, i] = _ONE
                places[beam, i] = _NOWHERE
                shares[beam, i] = _ZERO
                if not np.isnan(z):
                    still[beam, i] = beam_density(expected[beam, i] - z, sigma, wide, outliers, range_max)
                    out[i] += log(still[beam, i])
            continue
        for i in range(out.size):
            sine, cosine = sincos(theta[i] + angles[beam])
            # Of two numbers one of which is NaN, max and min return the first.
            column = min(max(_f(_SLANT), x[i] + z * cosine), _f(width - _SLANT - 2))
            row = min(max(_f(_SLANT), y[i] + z * sine), _f(height - _SLANT - 2))
            c, r = _i(np.rint(column)), _i(np.rint(row))
            along = beyond[r, c + _SLANT] - beyond[r, c - _SLANT]
            across = beyond[r + _SLANT, c] - beyond[r - _SLANT, c]
            slope = np.sqrt(along * along + across * across)
            facing = abs(along * cosine + across * sine) / max(slope, _ONE)
            distance = between_cells(beyond, column, row)

            j, f = node[r, c], share[r, c]
            k = following[j]
            moved = (_ONE - f) * displacement[ancestors[i], j] + f * displacement[ancestors[i], k]
            variance = node_variance(covariance, j, k, f)
            chance = (_ONE - f) * chances[j] + f * chances[k]
            error = distance - moved
            across_wall = rough + facing * facing * sensed
            spread = np.sqrt(variance + across_wall)
            stopped = chance * (_ONE - outliers) * facing * normal_density(error, spread)
            as_before = beam_density(expected[beam, i] - z, sigma, wide, outliers, range_max)
            likelihood = stopped + (_ONE - chance) * as_before + chance * outliers / range_max
            out[i] += log(likelihood)
            blame[beam, i] = stopped / max(likelihood, _TINY)
            stopped_at[beam, i] = distance
            noise[beam, i] = across_wall
            facings[beam, i] = facing
            still[beam, i] = as_before
            places[beam, i] = j
            shares[beam, i] = f


@kernel
def bulged(
    stopped_at,
    noise,
    facings,
    still,
    places,
    shares,
    following,
    shapes,
    near,
    outliers,
    range_max,
    generic,
    out,
    log_shapes,
    heights,
    variances,
):
    """Let ranges weigh bulges: displacements that are one of ``shapes`` (S, J) times a height that nobody knows.

    The first six are what ``changed`` found; ``near`` (J, W): the shapes that matter at each node. ``generic`` (N,):
    the log-likelihood where the displacement has no such shape. Updated in place, of each particle: ``log_shapes``
    (N, S + 1), log-probabilities, the last of no shape; ``heights`` and ``variances`` (N, S). Beams of one reading are
    taken in turn, a Kalman update each. Writes the log-likelihood over all of them to ``out`` (N,).
    """
    outliers, range_max = _f(outliers), _f(range_max)
    nothing = outliers / range_max
    beams, count = places.shape
    bulges = heights.shape[1]
    parts = np.empty(bulges + 1, dtype=np.float32)
    width = near.shape[1]
    reaches, height, variance, told = (
        np.empty(width, dtype=np.float32),
        np.empty(width, dtype=np.float32),
        np.empty(width, dtype=np.float32),
        np.empty(width, dtype=np.float32),
    )
    for i in range(count):
        base = _ZERO
        for beam in range(beams):
            base += log(still[beam, i])
        for beam in range(beams):
            j = places[beam, i]
            if j < _i(0):
                continue
            k, f = following[j], shares[beam, i]
            for w in range(width):
                s = near[j, w]
                reaches[w] = (_ONE - f) * shapes[s, j] + f * shapes[s, k]
                height[w], variance[w] = heights[i, s], variances[i, s]
            as_before, noisy, stopped_here = still[beam, i], noise[beam, i], stopped_at[beam, i]
            facing = (_ONE - outliers) * facings[beam, i]
            for w in range(width):  # apart from what is looked up: so it vectorizes
                reach = reaches[w]
                moved = min(max(reach - _LEAST_REACH, _ZERO) * _FAR, reach * _OVER_FULL_REACH)
                moved = min(moved, _ONE)
                explained = reach * reach * variance[w]
                error = stopped_here - reach * height[w]
                stopped = moved * facing * normal_density(error, np.sqrt(explained + noisy))
                likelihood = stopped + (_ONE - moved) * as_before + moved * nothing
                told[w] = log((likelihood + _TINY) / (as_before + _TINY))
                blame = stopped / max(likelihood, _TINY)
                blame = blame if blame > _LEAST_BLAME else _ZERO
                gain = blame * reach * variance[w] / (blame * explained + noisy)
                height[w] += gain * error
                variance[w] *= _ONE - gain * reach
            for w in range(width):
                s = near[j, w]
                log_shapes[i, s] += told[w]
                heights[i, s], variances[i, s] = height[w], variance[w]
        log_shapes[i, bulges] += generic[i] - base
        most = log_shapes[i, 0]
        for s in range(bulges + 1):
            most = max(most, log_shapes[i, s])
        for s in range(bulges + 1):  # apart from the sum: so it vectorizes
            parts[s] = exp(log_shapes[i, s] - most)
        total = _ZERO
        for s in range(bulges + 1):
            total += parts[s]
        evidence = most + log(total)
        for s in range(bulges + 1):
            log_shapes[i, s] -= evidence
        out[i] = base + evidence


@kernel
def follow_walls(blame, stopped_at, noise, places, shares, following, weights, displacement, covariance, chances):
    """Update displacements (N, J), their covariance (J, J) and chances (J,), in place, by where beams were stopped.

    A Kalman update a particle and beam, as FastSLAM's of a landmark (Montemerlo et al., 2002), its ``noise`` (B, N)
    divided by the blame (B, N). Covariance and chances are shared: they follow the mean over the particles, by
    ``weights`` (N,).
    """
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
            j, f = places[beam, i], shares[beam, i]
            if j >= _i(0):
                k = following[j]
                weight = np.float64(weights[i])
                part = weight * np.float64(blame[beam, i])
                blamed += part
                noisy += part * np.float64(noise[beam, i])
                seen[j] += weight * np.float64(_ONE - f)
                seen[k] += weight * np.float64(f)
                observed[j] += part * np.float64(_ONE - f)
                observed[k] += part * np.float64(f)
                if blame[beam, i] > _LEAST_BLAME:
                    moved = (_ONE - f) * displacement[i, j] + f * displacement[i, k]
                    variance = node_variance(covariance, j, k, f)
                    gain = (stopped_at[beam, i] - moved) / (variance + noise[beam, i] / blame[beam, i])
                    at_j, at_k = gain * (_ONE - f), gain * f
                    for n in range(nodes):
                        displacement[i, n] += at_j * covariance[j, n] + at_k * covariance[k, n]
        for n in range(nodes):
            chances[n] = _f(np.float64(chances[n]) + (observed[n] - seen[n] * np.float64(chances[n])) / total)
        if blamed > np.float64(_LEAST_BLAME) * total:
            condition(covariance, observed / blamed, noisy / blamed * total / blamed)


@kernel
def given_way(maps, since, transition, reading, maps_now, since_now, fresh):
    """Let maps give way to one another: write their probabilities (K, N), since when, and what of each has just begun.

    ``transition`` (K, K): from the row's map to the column's. ``since``: (K, N), and ``reading``: the number of the one
    from which on what begins now holds. ``fresh`` (N,): of the last map, the share that has just begun.
    """
    count, particles = maps.shape
    last = count - 1
    for to in range(count):
        for i in range(particles):
            maps_now[to, i] = _ZERO
        for of in range(count):
            chance = transition[of, to]
            for i in range(particles):
                maps_now[to, i] += maps[of, i] * chance
        stays = transition[to, to]
        for i in range(particles):
            begun = _ONE - stays * maps[to, i] / max(maps_now[to, i], _TINY)
            since_now[to, i] = since[to, i] + begun * (reading - since[to, i])
            if to == last:
                fresh[i] = begun


@kernel
def bulges_given_way(log_shapes, heights, variances, fresh, begun, height, variance, growth):
    """Mix bulges (see ``bulged``) with those that have just begun, of probability ``fresh`` (N,): by their moments.

    In place: ``log_shapes`` (N, S + 1), ``heights`` and ``variances`` (N, S). ``begun`` (S + 1,): log-probabilities of
    those that begin, ``height`` and ``variance`` of each. ``growth``: variance by which every height also moves on.
    """
    height, variance, growth = _f(height), _f(variance), _f(growth)
    count, bulges = heights.shape
    kept = np.empty(bulges + 1, dtype=np.float32)
    new = np.empty(bulges + 1, dtype=np.float32)
    for s in range(bulges + 1):
        new[s] = exp(begun[s])
    for i in range(count):
        stays = _ONE - fresh[i]
        for s in range(bulges + 1):
            old = stays * exp(log_shapes[i, s])
            mixed = old + fresh[i] * new[s] + _TINY
            kept[s] = old / mixed
            log_shapes[i, s] = log(mixed)
        for s in range(bulges):
            share = kept[s]
            off = heights[i, s] - height
            variances[i, s] = share * variances[i, s] + (_ONE - share) * (variance + share * (off * off)) + growth
            heights[i, s] = height + share * off


@kernel
def weighed(maps, ancestors, log_likelihood, posterior, total):
    """Weigh maps by what ranges say: write their probabilities (K, N) at particles, and the log-likelihood of all (N,).

    ``maps`` (K, M): their probabilities before, of which ``ancestors`` (N,) tells each particle's; ``log_likelihood``
    (K, N) under each of them. A map of probability zero keeps it.
    """
    count, particles = log_likelihood.shape
    most = np.full(particles, _IMPOSSIBLE)
    for k in range(count):
        for i in range(particles):
            before = maps[k, ancestors[i]]
            joint = log(before) + log_likelihood[k, i] if before > _ZERO else _IMPOSSIBLE
            posterior[k, i] = joint
            most[i] = max(most[i], joint)
    for i in range(particles):
        total[i] = _ZERO
    for k in range(count):
        for i in range(particles):
            posterior[k, i] = exp(posterior[k, i] - most[i])
            total[i] += posterior[k, i]
    for k in range(count):
        for i in range(particles):
            posterior[k, i] /= total[i]
    for i in range(particles):
        total[i] = most[i] + log(total[i])


@kernel
def displaced(unlisted, log_shapes, heights, displacement, chances, shapes, out):
    """Write how far nodes are expected to have moved where the walls are none that is listed, to ``out`` (J,).

    ``unlisted`` (N,): weights of particles there, float64. The sum of the displacement without a shape (N, J), where a
    node has more likely moved than not by its ``chances`` (J,), and of the bulges (see ``bulged``).
    """
    count, bulges = heights.shape
    nodes = chances.size
    expected = np.zeros(bulges)
    for n in range(nodes):
        out[n] = 0.0
    for i in range(count):
        for s in range(bulges):
            expected[s] += unlisted[i] * np.float64(exp(log_shapes[i, s]) * heights[i, s])
        shapeless = unlisted[i] * np.float64(exp(log_shapes[i, bulges]))
        for n in range(nodes):
            out[n] += shapeless * np.float64(displacement[i, n])
    for n in range(nodes):
        out[n] = out[n] if chances[n] > _HALF else 0.0
    for s in range(bulges):
        for n in range(nodes):
            out[n] += expected[s] * np.float64(shapes[s, n])


@kernel
def bearable(log_weights, log_likelihood, left, kept):
    """Return the largest share, up to ``left``, of log-likelihoods (N,) that leaves N_eff at ``kept`` of N: by halving.

    0.0 where weights (N,) as they are leave less than that.
    """
    shared, weights = np.empty_like(log_weights), np.empty_like(log_weights)
    low, high, share = 0.0, left, left
    for _ in range(_HALVINGS + 1):
        for i in range(log_weights.size):
            shared[i] = log_weights[i] + _f(share) * log_likelihood[i]
        _, total, squares = normalize(shared, weights)
        if not total * total < kept * log_weights.size * squares:
            low = share
            if share == left:
                break
        else:
            high = share
        share = 0.5 * (low + high)
    return low
