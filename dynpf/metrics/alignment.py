"""Whether an estimate and its reference are the same path in two frames: the rigid motion between them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.metrics.trajectory import PoseErrors, Trajectory
from dynpf.portable import atan2, hypot, sincos
from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray

__all__ = ["Alignment", "alignment", "moved_into"]

Pose = tuple[float, float, float]


class Alignment(NamedTuple):
    """The pose of the estimate's frame in the reference's (m, m, rad), and what errors are left once that is known."""

    offset: Pose
    position_rmse_m: float
    position_median_m: float
    heading_rmse_rad: float  # NaN where no heading of the reference is valid
    extent_m: float  # root mean square distance of the reference's positions from their middle


OUTLIER = 5.0
"""Median errors beyond which an estimate says nothing of the frames: there the filter was lost."""

_MOST_ROUNDS = 50


def alignment(estimate: Trajectory, errors: PoseErrors) -> Alignment | None:
    """Return the rigid motion that brings the estimates closest to their references; None for less than two of them.

    ``errors`` are those of ``pose_errors(estimate, reference)``. The sum of the squared distances of positions is least
    (Umeyama, 1991, without scale; its rotation has a closed form in the plane), over all estimates but those of a
    filter that was lost: the half that fits best is found first (least trimmed squares: Rousseeuw and Van Driessen,
    2006), then all within OUTLIER of the median error are taken. The errors are those of all estimates.
    """
    valid = errors.position_valid
    if np.count_nonzero(valid) < 2:
        return None
    ours = estimate.poses[:2, valid]
    theirs = ours - errors.errors[:2, valid]
    offset = _fitted(ours, theirs, np.ones(ours.shape[1], dtype=np.bool_))
    kept: NDArray[np.bool_] | None = None
    for _ in range(_MOST_ROUNDS):
        distance = _left(ours, theirs, offset)
        closest = distance <= np.median(distance)
        if kept is not None and np.array_equal(closest, kept):
            break
        kept, offset = closest, _fitted(ours, theirs, closest)
    distance = _left(ours, theirs, offset)
    offset = _fitted(ours, theirs, distance <= OUTLIER * max(float(np.median(distance)), 1e-9))
    distance = _left(ours, theirs, offset)
    turned = wrap_angle(errors.errors[2, errors.heading_valid] + offset[2])
    return Alignment(
        offset=offset,
        position_rmse_m=_rms(distance),
        position_median_m=float(np.median(distance)),
        heading_rmse_rad=_rms(turned) if turned.size else math.nan,
        extent_m=_rms(hypot(*(theirs - theirs.mean(axis=1, keepdims=True)))),
    )


def _fitted(ours: FloatArray, theirs: FloatArray, kept: NDArray[np.bool_]) -> Pose:
    """Return the rigid motion of positions (2, T) to others for which the sum of squared distances is least."""
    if np.count_nonzero(kept) < 2:
        kept = np.ones_like(kept)
    ours, theirs = ours[:, kept], theirs[:, kept]
    middle, their_middle = ours.mean(axis=1), theirs.mean(axis=1)
    a, b = ours - middle[:, None], theirs - their_middle[:, None]
    turn = atan2(float(np.sum(a[0] * b[1] - a[1] * b[0])), float(np.sum(a[0] * b[0] + a[1] * b[1])))
    sine, cosine = sincos(turn)
    x = float(their_middle[0]) - (cosine * float(middle[0]) - sine * float(middle[1]))
    y = float(their_middle[1]) - (sine * float(middle[0]) + cosine * float(middle[1]))
    return x, y, turn


def _left(ours: FloatArray, theirs: FloatArray, offset: Pose) -> FloatArray:
    """Return the distances (T,) that a rigid motion leaves, m."""
    sine, cosine = sincos(offset[2])
    x, y = ours
    dx, dy = cosine * x - sine * y + offset[0] - theirs[0], sine * x + cosine * y + offset[1] - theirs[1]
    found: FloatArray = hypot(dx, dy)
    return found


def moved_into(poses: FloatArray, offset: Pose) -> FloatArray:
    """Return poses (3, T) as they are seen from ``offset``, which is given in their own frame."""
    sine, cosine = sincos(offset[2])
    dx, dy = poses[0] - offset[0], poses[1] - offset[1]
    return np.stack((cosine * dx + sine * dy, cosine * dy - sine * dx, wrap_angle(poses[2] - offset[2])))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
