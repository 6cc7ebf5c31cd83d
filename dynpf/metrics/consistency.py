"""Whether a filter's covariances are honest about its errors.

The normalized estimation error squared (NEES) e^T P^-1 e of the state, and the normalized innovation squared (NIS) of
the readings, are chi-square when they are (Bar-Shalom, Li and Kirubarajan, 2001, section 5.4). The bands are for
independent values, from different runs or well separated instants: errors along one run are correlated.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dynpf.metrics.quantiles import chi_square_quantile, normal_quantile
from dynpf.types import FloatArray

__all__ = ["Consistency", "Verdict", "coverage", "mean_square", "nees"]


class Verdict(StrEnum):
    """What a figure outside its band says of the covariances."""

    CONSISTENT = "consistent"
    OVERCONFIDENT = "overconfident"  # the covariances are too small for the errors
    UNDERCONFIDENT = "underconfident"  # the covariances are too large for the errors


class Consistency(NamedTuple):
    """A figure over so many ``samples``, what is expected of it, and the band that holds it in a consistent filter."""

    verdict: Verdict
    figure: float
    expected: float
    low: float
    high: float
    samples: int


def nees(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return e^T P^-1 e of errors (D, T) under covariances (T, D, D), shape (T,); NaN where P is singular.

    Angles among the errors must have been taken the short way round. Innovations and their covariances give the NIS.
    """
    result = np.full(errors.shape[1], np.nan)
    regular = np.linalg.matrix_rank(covariances) == errors.shape[0]
    solved = np.linalg.solve(covariances[regular], errors.T[regular][..., None])[..., 0]
    result[regular] = np.einsum("td,td->t", errors.T[regular], solved)
    return result


def mean_square(values: FloatArray, degrees: ArrayLike, probability: float = 0.95) -> Consistency:
    """Return whether the mean of NEES or NIS values (T,) is that of a consistent filter.

    Each is chi-square with ``degrees`` of freedom: D or M, the same for all or an array (T,). The band holds the mean
    with ``probability``, equal tails. Values that are NaN are left out; raises ValueError when none remains.
    """
    used, freedoms = _finite(values, degrees)
    total, count = float(freedoms.sum()), used.size
    tail = 0.5 * (1.0 - probability)
    low, high = (chi_square_quantile(share, total) / count for share in (tail, 1.0 - tail))
    figure = float(np.mean(used))
    too_large, too_small = figure > high, figure < low
    verdict = Verdict.OVERCONFIDENT if too_large else Verdict.UNDERCONFIDENT if too_small else Verdict.CONSISTENT
    return Consistency(verdict, figure, total / count, low, high, count)


def coverage(values: FloatArray, degrees: ArrayLike, nominal: float = 0.95, probability: float = 0.95) -> Consistency:
    """Return whether the truth lies inside the ellipsoid of probability ``nominal`` as often as it should.

    ``values`` and ``degrees`` as for mean_square; the squared error of one row over its variance, with one degree,
    is for the interval of that row. A share is in the band just when its Wilson interval (seeds.proportion) holds
    ``nominal``. Values that are NaN are left out; raises ValueError when none remains.
    """
    used, freedoms = _finite(values, degrees)
    kinds, which = np.unique(freedoms, return_inverse=True)
    limits = np.array([chi_square_quantile(nominal, float(kind)) for kind in kinds])[which]
    figure = float(np.mean(used <= limits))
    reach = normal_quantile(0.5 * (1.0 + probability)) * (nominal * (1.0 - nominal) / used.size) ** 0.5
    low, high = max(nominal - reach, 0.0), min(nominal + reach, 1.0)
    verdict = Verdict.OVERCONFIDENT if figure < low else Verdict.UNDERCONFIDENT if figure > high else Verdict.CONSISTENT
    return Consistency(verdict, figure, nominal, low, high, used.size)


def _finite(values: FloatArray, degrees: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the values that are not NaN, and the degrees of freedom of each."""
    kept = ~np.isnan(values)
    if not kept.any():
        raise ValueError(f"no value to judge: {values.size} given, none of them a number")
    return values[kept], np.broadcast_to(np.asarray(degrees, dtype=np.float64), values.shape)[kept]
