"""What a weighted set of particles says about the pose: its mean and covariance."""

from typing import NamedTuple

import numpy as np

from dynpf.se2 import FloatArray, circular_mean, wrap_angle

__all__ = ["PoseEstimate", "pose_estimate", "weighted_covariance"]


class PoseEstimate(NamedTuple):
    """Mean pose (x, y, theta), shape (3,), and its covariance (m^2, m rad, rad^2), shape (3, 3)."""

    mean: FloatArray
    covariance: FloatArray


def pose_estimate(particles: FloatArray, weights: FloatArray) -> PoseEstimate:
    """Return mean and covariance of particles (D, N), D >= 3, under normalized weights (N,).

    The heading's mean is the circular one, and its deviations are taken the short way round.
    """
    position = np.sum(weights * particles[:2], axis=1)
    mean = np.append(position, circular_mean(particles[2], weights))
    deviation = particles[:3] - mean[:, None]
    deviation[2] = wrap_angle(deviation[2])
    return PoseEstimate(mean, weighted_covariance(deviation, weights))


def weighted_covariance(deviation: FloatArray, weights: FloatArray) -> FloatArray:
    """Return sum w d d^T of deviations (D, N) from their mean, shape (D, D).

    Summed without BLAS, whose threads would make the last bits depend on the number of processors.
    """
    covariance: FloatArray = np.einsum("in,jn->ij", weights * deviation, deviation)
    return covariance
