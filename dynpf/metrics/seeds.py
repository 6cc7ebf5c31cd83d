"""Figures over runs that differ by their seeds, with the uncertainty that so many runs leave.

NaN stands for what could not be scored and is left out; a figure over nothing is NaN.
"""

from typing import NamedTuple

import numpy as np

from dynpf.metrics.quantiles import normal_quantile, student_t_quantile
from dynpf.types import FloatArray

__all__ = ["Mean", "Proportion", "Spread", "mean", "proportion", "spread"]


class Spread(NamedTuple):
    """Median and percentiles of the values of so many ``runs``."""

    p5: float
    p25: float
    median: float
    p75: float
    p95: float
    runs: int


class Mean(NamedTuple):
    """Mean of the values of so many ``runs``, and the interval that holds the true mean at the confidence asked for."""

    mean: float
    low: float
    high: float
    runs: int


class Proportion(NamedTuple):
    """Share of successes, and the interval that holds the true rate with the confidence asked for."""

    rate: float
    low: float
    high: float


def spread(values: FloatArray) -> Spread:
    """Return the median and percentiles of values (runs,), interpolated linearly."""
    known = values[~np.isnan(values)]
    p5, p25, median, p75, p95 = np.quantile(known, (0.05, 0.25, 0.5, 0.75, 0.95)) if known.size else [np.nan] * 5
    return Spread(float(p5), float(p25), float(median), float(p75), float(p95), known.size)


def mean(values: FloatArray, confidence: float = 0.95) -> Mean:
    """Return the mean of values (runs,) with Student's interval; a single value leaves the true mean unbounded."""
    known = values[~np.isnan(values)]
    if not known.size:
        return Mean(np.nan, np.nan, np.nan, 0)
    centre = float(np.mean(known))
    if known.size == 1:
        return Mean(centre, -np.inf, np.inf, 1)
    error = float(np.std(known, ddof=1)) / known.size**0.5
    reach = student_t_quantile(0.5 * (1.0 + confidence), known.size - 1) * error
    return Mean(centre, centre - reach, centre + reach, known.size)


def proportion(successes: int, trials: int, confidence: float = 0.95) -> Proportion:
    """Return the share of successes with Wilson's score interval (1927); no trial leaves the rate anywhere.

    Raises ValueError unless 0 <= successes <= trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"successes = {successes}, trials = {trials}: expected 0 <= successes <= trials")
    if trials == 0:
        return Proportion(np.nan, 0.0, 1.0)
    z = normal_quantile(0.5 * (1.0 + confidence))
    rate = successes / trials
    centre = rate + z**2 / (2.0 * trials)
    reach = z * (rate * (1.0 - rate) / trials + z**2 / (4.0 * trials**2)) ** 0.5
    scale = 1.0 + z**2 / trials
    return Proportion(rate, max((centre - reach) / scale, 0.0), min((centre + reach) / scale, 1.0))
