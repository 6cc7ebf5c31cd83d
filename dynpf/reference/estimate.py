"""Mean and covariance of weighted poses, from the definition."""

import numpy as np

from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray, Floats

__all__ = ["pose_moments"]


def pose_moments(x: Floats, y: Floats, theta: Floats, weights: Floats) -> tuple[FloatArray, FloatArray]:
    """Return mean (3,) and covariance (3, 3) of poses and weights (N,); all NaN where the weights' sum is zero.

    The heading's mean is the direction of the mean unit vector; its deviations are taken the short way round.
    """
    poses = np.array([x, y, theta], dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.sum(weights, dtype=np.float64)
        mean = np.sum(weights * poses, axis=1) / total
        mean[2] = np.arctan2(np.sum(weights * np.sin(poses[2])), np.sum(weights * np.cos(poses[2])))
        deviation = poses - mean[:, None]
        deviation[2] = wrap_angle(deviation[2])
        return mean, np.einsum("in,jn->ij", weights * deviation, deviation) / total
