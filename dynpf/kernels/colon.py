"""COLON: how likely ranges are where a listed map holds, and which of the listed maps holds.

Ranges are read by B beams; beams are rows, particles columns. A range that is NaN carries no information, and one at
the cap only that the wall is farther.
"""

import numpy as np

from dynpf.kernels.cloud import normalize
from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import exp, log

__all__ = ["beam_density", "bearable", "given_way", "listed", "normal_density", "weighed"]

_f = np.float32
_ZERO, _HALF, _ONE = _f(0.0), _f(0.5), _f(1.0)
_ONE_OVER_ROOT_TWO_PI = _f(0.3989422804014327)
# Most ranges are as good as the noise says, a few are worse: near edges a small error of the pose is a large one of
# the range.
_WIDE_SHARE = _f(0.07)
_TINY = _f(1e-30)
_IMPOSSIBLE = _f(-np.inf)
_HALVINGS = 16


@device
def normal_density(error, sigma):
    """Return the density of a Gaussian error."""
    scaled = error / sigma
    return _ONE_OVER_ROOT_TWO_PI / sigma * exp(-_HALF * scaled * scaled)


@device
def beam_density(error, sigma, wide, outliers, range_max):
    """Return the density of a range's error: two Gaussians about zero, and anything up to the cap."""
    narrow = (_ONE - _WIDE_SHARE - outliers) * normal_density(error, sigma)
    return narrow + _WIDE_SHARE * normal_density(error, wide) + outliers / range_max


@kernel
def listed(expected, read, noise, out):
    """Write the log-likelihood of ranges ``read`` (B,) where ``expected`` (B, N) are right, to ``out`` (N,).

    ``noise``: a ``dynpf.colon.beams.Noise``.
    """
    sigma, wide, outliers, range_max = _f(noise.sigma), _f(noise.wide), _f(noise.outliers), _f(noise.range_max)
    out[:] = _ZERO
    for beam in range(read.size):
        if not np.isnan(read[beam]):
            for i in range(out.size):
                out[i] += log(beam_density(expected[beam, i] - read[beam], sigma, wide, outliers, range_max))


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
def weighed(maps, ancestors, log_likelihood, posterior, total):
    """Weigh maps by what ranges say: write their probabilities (K, N) at particles, and the log-likelihood of all (N,).

    ``maps`` (K, M): their probabilities before, of which ``ancestors`` (N,) is the index of each particle's;
    ``log_likelihood`` (K, N) under each of them. A map of probability zero keeps it.
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
