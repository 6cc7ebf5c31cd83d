"""COLON's likelihoods in NumPy: the textbook form of ``dynpf.kernels.colon``."""

import numpy as np
from numpy.typing import NDArray

from dynpf.colon.beams import Noise
from dynpf.colon.evidence import Beams, Bulges, Displacements, Stops, WallNoise
from dynpf.colon.wall import Wall
from dynpf.types import FloatArray, Floats

__all__ = ["beam_density", "bulged", "changed", "follow_walls", "listed"]

WIDE_SHARE = 0.07
SLANT = 3
LEAST_BLAME = 1e-3
LEAST_REACH, FULL_REACH = 0.05, 0.25


def beam_density(error: Floats, noise: Noise | WallNoise) -> FloatArray:
    """Return the density of a range's error: two Gaussians about zero, and anything up to the cap."""
    narrow = (1.0 - WIDE_SHARE - noise.outliers) * _normal(error, noise.sigma)
    return narrow + WIDE_SHARE * _normal(error, noise.wide) + noise.outliers / noise.range_max


def listed(expected: Floats, read: Floats, noise: Noise) -> FloatArray:
    """Return the log-likelihood (N,) of ranges (B,) where ``expected`` (B, N) are right."""
    known = ~np.isnan(read)
    errors = expected[known] - read[known, None]
    total: FloatArray = np.log(beam_density(errors, noise)).sum(axis=0)
    return total


def changed(beams: Beams, walls: Wall, displacements: Displacements, noise: WallNoise) -> tuple[FloatArray, Stops]:
    """Return log-likelihoods (N,), and where beams were stopped."""
    read, expected, outliers, range_max = beams.read, beams.expected, noise.outliers, noise.range_max
    beyond, node, share, following = walls.beyond, walls.node, walls.share, walls.following
    own, rough = displacements.means[displacements.ancestors], noise.roughness**2
    total = np.zeros(expected.shape[1])
    blame, stopped_at, facings, shares = (np.zeros(expected.shape) for _ in range(4))
    variance_at, unmoved = np.full(expected.shape, rough), np.ones(expected.shape)
    nodes = np.full(expected.shape, -1, dtype=np.int32)
    height, width = beyond.shape
    for b in np.flatnonzero(~np.isnan(read)):
        still = beam_density(expected[b] - read[b], noise)
        unmoved[b] = still
        if read[b] >= range_max:
            total += np.log(still)
            continue
        direction = beams.theta + beams.angles[b]
        cosine, sine = np.cos(direction), np.sin(direction)
        column = np.clip(beams.x + read[b] * cosine, SLANT, width - SLANT - 2)
        row = np.clip(beams.y + read[b] * sine, SLANT, height - SLANT - 2)
        c, r = np.rint(column).astype(int), np.rint(row).astype(int)
        along = beyond[r, c + SLANT] - beyond[r, c - SLANT]
        across = beyond[r + SLANT, c] - beyond[r - SLANT, c]
        facings[b] = facing = np.abs(along * cosine + across * sine) / np.maximum(np.hypot(along, across), 1.0)
        variance_at[b] = rough + facing**2 * noise.sigma_range**2
        stopped_at[b] = _between_cells(beyond, column, row)
        nodes[b], shares[b] = node[r, c], share[r, c]
        moved, variance = _at_nodes(own, displacements.covariance, nodes[b], following[nodes[b]], shares[b])
        chances = displacements.chances
        chance = (1.0 - shares[b]) * chances[nodes[b]] + shares[b] * chances[following[nodes[b]]]
        spread = np.sqrt(variance + variance_at[b])
        stopped = chance * (1.0 - outliers) * facing * _normal(stopped_at[b] - moved, spread)
        likelihood = stopped + (1.0 - chance) * still + chance * outliers / range_max
        total += np.log(likelihood)
        blame[b] = stopped / likelihood
    return total, Stops(blame, stopped_at, variance_at, facings, unmoved, nodes, shares)


def bulged(stops: Stops, walls: Wall, noise: WallNoise, shapeless: Floats, bulges: Bulges) -> tuple[FloatArray, Bulges]:
    """Return log-likelihoods (N,), and what is known of bulges afterwards."""
    after, mean, variance = (np.array(a, dtype=np.float64) for a in bulges)
    nodes, shares, still, shapes = stops.node, stops.share, stops.unmoved, walls.shapes
    variance_at = stops.variance + noise.bulge_roughness**2
    base = np.log(still).sum(axis=0)
    for b, i in np.argwhere(nodes >= 0):
        j = nodes[b, i]
        reach = (1.0 - shares[b, i]) * shapes[:, j] + shares[b, i] * shapes[:, walls.following[j]]
        there = reach >= LEAST_REACH
        moved = np.minimum(reach / FULL_REACH, 1.0)
        total = reach**2 * variance[i] + variance_at[b, i]
        error = stops.distance[b, i] - reach * mean[i]
        stopped = moved * (1.0 - noise.outliers) * stops.facing[b, i] * _normal(error, np.sqrt(total))
        likelihood = stopped + (1.0 - moved) * still[b, i] + moved * noise.outliers / noise.range_max
        after[i, :-1] += np.where(there, np.log(likelihood / still[b, i]), 0.0)
        blame = stopped / likelihood
        learnt = there & (blame > LEAST_BLAME)
        gain = np.where(learnt, blame, 0.0) * reach * variance[i] / (blame * reach**2 * variance[i] + variance_at[b, i])
        mean[i] += gain * error
        variance[i] *= 1.0 - gain * reach
    after[:, -1] += shapeless - base
    evidence = np.logaddexp.reduce(after, axis=1)
    return base + evidence, Bulges(after - evidence[:, None], mean, variance)


def follow_walls(
    stops: Stops, following: NDArray[np.int32], weights: Floats, displacements: Displacements
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return displacements (N, J), their covariance (J, J) and chances (J,) after where each beam was stopped."""
    held = displacements.means, displacements.covariance, displacements.chances
    mean, shared, moved = (np.array(a, dtype=np.float64) for a in held)
    blame, stopped_at, noise, nodes, shares = stops.blame, stops.distance, stops.variance, stops.node, stops.share
    weights = weights / weights.sum()
    for b in np.flatnonzero((nodes >= 0).all(axis=1)):
        observes = np.zeros(mean.shape)
        particles = np.arange(len(mean))
        observes[particles, nodes[b]] += 1.0 - shares[b]
        observes[particles, following[nodes[b]]] += shares[b]
        cross = observes @ shared
        variance = np.sum(cross * observes, axis=1)
        of_each = np.divide(noise[b], blame[b], out=np.full(len(mean), np.inf), where=blame[b] > LEAST_BLAME)
        gain = cross / (variance + of_each)[:, None]
        mean += gain * (stopped_at[b] - np.sum(observes * mean, axis=1))[:, None]
        blamed = np.sum(weights * blame[b])
        observed = np.sum((weights * blame[b])[:, None] * observes, axis=0)
        moved += observed - np.sum(weights[:, None] * observes, axis=0) * moved
        if blamed > LEAST_BLAME:
            together = shared @ (observed / blamed)
            shared -= np.outer(together, together) / (
                observed @ together / blamed + np.sum(weights * blame[b] * noise[b]) / blamed**2
            )
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
