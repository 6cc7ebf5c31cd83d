"""The beam model's density and its sum over beams, for ``dynpf.kernels.beam``."""

import math

import numpy as np

from dynpf.types import FloatArray

__all__ = ["density", "sum_over_beams"]


def density(
    reading: float,
    length: float,
    range_max: float,
    weights: tuple[float, float, float, float],
    scales: tuple[float, float],
) -> float:
    """Return p(reading | length of the ray): per metre, and the mass of the maximum at the maximum.

    ``weights`` of hit, short, max and rand; ``scales``: sigma_hit and lambda_short (Thrun et al., 2005, eq. 6.4 to
    6.12).
    """
    sigma, decay = scales
    upper, lower = (range_max - length) / sigma, -length / sigma
    within = 0.5 * (math.erf(upper / math.sqrt(2.0)) - math.erf(lower / math.sqrt(2.0)))
    hit = math.exp(-0.5 * ((reading - length) / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma * within)
    short = 0.0
    if reading <= length and length > 0.0:
        short = decay * math.exp(-decay * reading) / (1.0 - math.exp(-decay * length))
    at_max = 1.0 if reading >= range_max else 0.0
    rand = 1.0 / range_max if reading < range_max else 0.0
    return sum(weight * part for weight, part in zip(weights, (hit, short, at_max, rand), strict=True))


def sum_over_beams(
    readings: FloatArray,
    lengths: FloatArray,
    range_max: float,
    weights: tuple[float, float, float, float],
    scales: tuple[float, float],
) -> FloatArray:
    """Return the log-likelihood (N,) of readings (B,) where the rays have ``lengths`` (B, N)."""
    logs = [
        [math.log(density(reading, length, range_max, weights, scales)) for length in row]
        for reading, row in zip(readings.tolist(), lengths.tolist(), strict=True)
    ]
    total: FloatArray = np.sum(np.array(logs).reshape(lengths.shape), axis=0)
    return total
