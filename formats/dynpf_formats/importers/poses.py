"""Single poses (x, y, theta) in the plane as tuples of floats, metres and radians.

``dynpf.se2`` works on arrays and wraps angles by another rounding; imported recordings keep these bytes.
"""

import math

from dynpf.portable import sincos

__all__ = ["Pose", "compose", "inverse", "relative", "wrapped"]

Pose = tuple[float, float, float]


def wrapped(angle: float) -> float:
    """Return an angle in [-pi, pi]."""
    return math.remainder(angle, math.tau)


def compose(pose: Pose, step: Pose) -> Pose:
    """Return ``step``, given in the frame of ``pose``, in the frame of ``pose`` itself."""
    sine, cosine = sincos(pose[2])
    x = pose[0] + cosine * step[0] - sine * step[1]
    y = pose[1] + sine * step[0] + cosine * step[1]
    return x, y, wrapped(pose[2] + step[2])


def inverse(pose: Pose) -> Pose:
    """Return the pose of the reference frame in the frame of ``pose``."""
    sine, cosine = sincos(pose[2])
    return -cosine * pose[0] - sine * pose[1], sine * pose[0] - cosine * pose[1], wrapped(-pose[2])


def relative(start: Pose, end: Pose) -> Pose:
    """Return ``end`` in the frame of ``start``; both are given in a common frame."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    sine, cosine = sincos(start[2])
    return cosine * dx + sine * dy, cosine * dy - sine * dx, wrapped(end[2] - start[2])
