"""Twins of ``dynpf.kernels.landmarks`` in double precision."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray, Floats

__all__ = ["distances", "innovations", "log_likelihood", "log_likelihood_unlabelled"]

Integers = NDArray[np.integer[Any]]


def innovations(
    x: Floats, y: Floats, theta: Floats, *, distance: float, bearing: float, east: float, north: float
) -> FloatArray:
    """Return a reading less its expectation at poses (N,) of a landmark at (east, north), shape (2, N)."""
    along, across = east - x.astype(np.float64), north - y.astype(np.float64)
    return np.stack((distance - np.hypot(along, across), wrap_angle(bearing - np.arctan2(across, along) + theta)))


def log_likelihood(
    x: Floats,
    y: Floats,
    theta: Floats,
    *,
    landmarks: Integers,
    ranges: Floats,
    bearings: Floats,
    ids: Integers,
    easts: Floats,
    norths: Floats,
    sigma_range: float,
    sigma_range_per_m: float,
    sigma_bearing: float,
    outlier_fraction: float,
    outlier_range: float,
    tempering: float,
) -> FloatArray:
    """Return the tempered log-density of readings (K,) of landmarks of the map (M,) at poses (N,), shape (N,)."""
    total = np.zeros(x.size)
    for landmark, distance, bearing in zip(landmarks, ranges, bearings, strict=True):
        if landmark not in ids or not np.isfinite((distance, bearing)).all():
            continue
        m = int(np.flatnonzero(ids == landmark)[0])
        errors = innovations(x, y, theta, distance=distance, bearing=bearing, east=easts[m], north=norths[m])
        log_density = _log_density(errors, np.hypot(sigma_range, sigma_range_per_m * distance), sigma_bearing)
        total += _with_outliers(log_density, outlier_fraction, outlier_range)
    return tempering * total


def distances(
    x: Floats,
    y: Floats,
    theta: Floats,
    weights: Floats,
    *,
    landmarks: Integers,
    ranges: Floats,
    bearings: Floats,
    ids: Integers,
    easts: Floats,
    norths: Floats,
    sigma_range: float,
    sigma_range_per_m: float,
    sigma_bearing: float,
) -> FloatArray:
    """Return the squared Mahalanobis distance of each reading's mean innovation, NaN without information, (K,)."""
    normalized = weights.astype(np.float64) / np.sum(weights, dtype=np.float64)
    out = np.full(len(ranges), np.nan)
    for k, (landmark, distance, bearing) in enumerate(zip(landmarks, ranges, bearings, strict=True)):
        if landmark not in ids or not np.isfinite((distance, bearing)).all():
            continue
        m = int(np.flatnonzero(ids == landmark)[0])
        errors = innovations(x, y, theta, distance=distance, bearing=bearing, east=easts[m], north=norths[m])
        mean = np.sum(normalized * errors, axis=1)
        deviation = errors - mean[:, None]
        covariance = np.einsum("in,jn->ij", normalized * deviation, deviation)
        covariance += np.diag((sigma_range**2 + (sigma_range_per_m * distance) ** 2, sigma_bearing**2))
        out[k] = mean @ np.linalg.solve(covariance, mean)
    return out


def log_likelihood_unlabelled(
    x: Floats,
    y: Floats,
    theta: Floats,
    *,
    ranges: Floats,
    bearings: Floats,
    easts: Floats,
    norths: Floats,
    mixture: bool,
    sigma_range: float,
    sigma_range_per_m: float,
    sigma_bearing: float,
    outlier_fraction: float,
    outlier_range: float,
    tempering: float,
) -> FloatArray:
    """Return the tempered log-density of readings (K,) of any of the landmarks (M,) at poses (N,), shape (N,).

    Of the landmarks' densities, the greatest is taken, or with ``mixture`` the mean.
    """
    total = np.zeros(x.size)
    for distance, bearing in zip(ranges, bearings, strict=True):
        if not np.isfinite((distance, bearing)).all():
            continue
        sigma = np.hypot(sigma_range, sigma_range_per_m * distance)
        log_densities = np.stack(
            [
                _log_density(
                    innovations(x, y, theta, distance=distance, bearing=bearing, east=east, north=north),
                    sigma,
                    sigma_bearing,
                )
                for east, north in zip(easts, norths, strict=True)
            ]
        )
        log_density = np.max(log_densities, axis=0)
        if mixture:
            log_density = np.logaddexp.reduce(log_densities, axis=0) - np.log(len(easts))
        total += _with_outliers(log_density, outlier_fraction, outlier_range)
    return tempering * total


def _log_density(errors: FloatArray, sigma_range: float, sigma_bearing: float) -> FloatArray:
    """Return the Gaussian log-density of errors (2, N) of range and bearing, shape (N,)."""
    squared = (errors[0] / sigma_range) ** 2 + (errors[1] / sigma_bearing) ** 2
    log_density: FloatArray = -0.5 * squared - np.log(2.0 * np.pi * sigma_range * sigma_bearing)
    return log_density


def _with_outliers(log_density: FloatArray, fraction: float, reach: float) -> FloatArray:
    """Return the log-density with a share of outliers, uniform up to ``reach`` metres and over the circle."""
    if fraction == 0.0:
        return log_density
    mixed: FloatArray = np.logaddexp(np.log1p(-fraction) + log_density, np.log(fraction / (2.0 * np.pi * reach)))
    return mixed
