"""What a weighted set of particles says about the pose: its mean and covariance."""

from typing import NamedTuple

import numpy as np

from dynpf.se2 import FloatArray, circular_mean, wrap_angle

__all__ = ["PoseEstimate", "pose_estimate"]


class PoseEstimate(NamedTuple):
    """Mean pose (x, y, theta), shape (3,), and its covariance (m^2, m rad, rad^2), shape (3, 3)."""

    mean: FloatArray
    covariance: FloatArray


def pose_estimate(particles: FloatArray, weights: FloatArray) -> PoseEstimate:
    """Return mean and covariance of particles (D, N), D >= 3, under normalized weights (N,).

    The heading's mean is the circular one, and its deviations are taken the short way round.
    """
    mean = np.array(
        [
            np.dot(weights, particles[0]),
            np.dot(weights, particles[1]),
            circular_mean(particles[2], weights),
        ]
    )
    deviation = particles[:3] - mean[:, None]
    deviation[2] = wrap_angle(deviation[2])
    return PoseEstimate(mean, (deviation * weights) @ deviation.T)
