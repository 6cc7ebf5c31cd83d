"""The linear Kalman filter: a Gaussian belief as mean (d,) and covariance (d, d), predicted and updated."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["predict", "update"]

FloatArray = NDArray[np.float64]


def predict(
    mean: FloatArray, covariance: FloatArray, transition: FloatArray, process_covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of F x + noise; a random walk has F = I (PARTS eq. 3.28 and 3.29)."""
    return transition @ mean, transition @ covariance @ transition.T + process_covariance


def update(
    mean: FloatArray,
    covariance: FloatArray,
    measurement: FloatArray,
    observation: FloatArray,
    measurement_covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance given ``measurement`` = H x + noise, (m,), with H (m, d) (PARTS eq. 3.30, 3.31).

    The covariance is updated in Joseph's form, which stays symmetric and positive semi-definite. Raises
    numpy.linalg.LinAlgError when the innovation covariance is singular.
    """
    innovation_covariance = observation @ covariance @ observation.T + measurement_covariance
    gain = np.linalg.solve(innovation_covariance, observation @ covariance).T
    remainder = np.eye(mean.size) - gain @ observation
    return (
        mean + gain @ (measurement - observation @ mean),
        remainder @ covariance @ remainder.T + gain @ measurement_covariance @ gain.T,
    )
