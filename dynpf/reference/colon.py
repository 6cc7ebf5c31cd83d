"""COLON's likelihoods in NumPy: the textbook form of ``dynpf.kernels.colon``."""

import numpy as np
from numpy.typing import NDArray

from dynpf.se2 import FloatArray, Floats

__all__ = ["beam_density", "changed", "follow_walls", "listed"]

WIDE_SHARE = 0.07
SLANT = 3
LEAST_BLAME = 1e-3


def beam_density(error: Floats, sigma: float, wide: float, outliers: float, range_max: float) -> FloatArray:
    """Return the density of a range's error: two Gaussians about zero, and anything up to the cap."""
    narrow = (1.0 - WIDE_SHARE - outliers) * _normal(error, sigma)
    return narrow + WIDE_SHARE * _normal(error, wide) + outliers / range_max


def listed(  # noqa: PLR0917 - as the kernel takes them
    expected: Floats, read: Floats, sigma: float, wide: float, outliers: float, range_max: float
) -> FloatArray:
    """Return the log-likelihood (N,) of ranges (B,) where ``expected`` (B, N) are right."""
    known = ~np.isnan(read)
    errors = expected[known] - read[known, None]
    total: FloatArray = np.log(beam_density(errors, sigma, wide, outliers, range_max)).sum(axis=0)
    return total


def changed(  # noqa: PLR0917 - as the kernel takes them
    poses: Floats,
    angles: Floats,
    read: Floats,
    expected: Floats,
    beyond: Floats,
    node: NDArray[np.int32],
    share: Floats,
    following: NDArray[np.int32],
    displacement: Floats,
    covariance: Floats,
    chances: Floats,
    sigma: float,
    wide: float,
    roughness: float,
    outliers: float,
    range_max: float,
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int32], FloatArray]:
    """Return log-likelihoods (N,), blame, where beams were stopped, node and share, each (B, N), of poses (3, N)."""
    beams, count = expected.shape
    total = np.zeros(count)
    blame, stopped_at, shares = (np.zeros((beams, count)) for _ in range(3))
    places = np.full((beams, count), -1, dtype=np.int32)
    height, width = beyond.shape
    for b in np.flatnonzero(~np.isnan(read)):
        still = beam_density(expected[b] - read[b], sigma, wide, outliers, range_max)
        if read[b] >= range_max:
            total += np.log(still)
            continue
        direction = poses[2] + angles[b]
        cosine, sine = np.cos(direction), np.sin(direction)
        column = np.clip(poses[0] + read[b] * cosine, SLANT, width - SLANT - 2)
        row = np.clip(poses[1] + read[b] * sine, SLANT, height - SLANT - 2)
        c, r = np.rint(column).astype(int), np.rint(row).astype(int)
        along = beyond[r, c + SLANT] - beyond[r, c - SLANT]
        across = beyond[r + SLANT, c] - beyond[r - SLANT, c]
        facing = np.abs(along * cosine + across * sine) / np.maximum(np.hypot(along, across), 1.0)
        stopped_at[b] = _between_cells(beyond, column, row)
        places[b], shares[b] = node[r, c], share[r, c]
        moved, variance = _at_nodes(displacement, covariance, places[b], following[places[b]], shares[b])
        chance = (1.0 - shares[b]) * chances[places[b]] + shares[b] * chances[following[places[b]]]
        spread = np.sqrt(variance + roughness**2)
        stopped = chance * (1.0 - outliers) * facing * _normal(stopped_at[b] - moved, spread)
        likelihood = stopped + (1.0 - chance) * still + chance * outliers / range_max
        total += np.log(likelihood)
        blame[b] = stopped / likelihood
    return total, blame, stopped_at, places, shares


def follow_walls(  # noqa: PLR0917 - likewise
    blame: Floats,
    stopped_at: Floats,
    places: NDArray[np.int32],
    shares: Floats,
    following: NDArray[np.int32],
    roughness: float,
    weights: Floats,
    displacement: Floats,
    covariance: Floats,
    chances: Floats,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return displacements (N, J), their covariance (J, J) and chances (J,) after where each beam was stopped."""
    mean, shared, moved = (np.array(a, dtype=np.float64) for a in (displacement, covariance, chances))
    weights = weights / weights.sum()
    for b in np.flatnonzero((places >= 0).all(axis=1)):
        observes = np.zeros(mean.shape)
        particles = np.arange(len(mean))
        observes[particles, places[b]] += 1.0 - shares[b]
        observes[particles, following[places[b]]] += shares[b]
        cross = observes @ shared
        variance = np.sum(cross * observes, axis=1)
        noise = np.divide(roughness**2, blame[b], out=np.full(len(mean), np.inf), where=blame[b] > LEAST_BLAME)
        gain = cross / (variance + noise)[:, None]
        mean += gain * (stopped_at[b] - np.sum(observes * mean, axis=1))[:, None]
        blamed = np.sum(weights * blame[b])
        observed = np.sum((weights * blame[b])[:, None] * observes, axis=0)
        moved += observed - np.sum(weights[:, None] * observes, axis=0) * moved
        if blamed > LEAST_BLAME:
            together = shared @ (observed / blamed)
            shared -= np.outer(together, together) / (observed @ together / blamed + roughness**2 / blamed)
    return mean, shared, moved


def _normal(error: Floats, sigma: FloatArray | float) -> FloatArray:
    density: FloatArray = np.exp(-0.5 * (error / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
    return density


def _between_cells(table: Floats, column: Floats, row: Floats) -> FloatArray:
    c, r = np.floor(column).astype(int), np.floor(row).astype(int)
    right, above = column - c, row - r
    low = (1.0 - right) * table[r, c] + right * table[r, c + 1]
    high = (1.0 - right) * table[r + 1, c] + right * table[r + 1, c + 1]
    between: FloatArray = (1.0 - above) * low + above * high
    return between


def _at_nodes(
    displacement: Floats, covariance: Floats, j: NDArray[np.int32], k: NDArray[np.int32], share: Floats
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance of the displacement between nodes j and k, (N,) each."""
    particles, rest = np.arange(len(displacement)), 1.0 - share
    mean = rest * displacement[particles, j] + share * displacement[particles, k]
    variance = rest**2 * covariance[j, j] + 2.0 * rest * share * covariance[j, k] + share**2 * covariance[k, k]
    return mean, variance
