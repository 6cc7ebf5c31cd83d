"""How far an estimated trajectory is from the truth."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.se2 import arc_displacement, compose, wrap_angle
from dynpf.types import FloatArray

__all__ = [
    "PoseErrors",
    "Trajectory",
    "TrajectoryScore",
    "dead_reckoning",
    "pose_errors",
    "score",
    "thin",
]

BoolArray = NDArray[np.bool_]


class Trajectory(NamedTuple):
    """Stamps in seconds, ascending, shape (T,), and poses (x, y, theta), shape (3, T)."""

    stamps: FloatArray
    poses: FloatArray


class PoseErrors(NamedTuple):
    """Estimate minus truth (m, m, rad), shape (3, T), and where position and heading can be scored, shape (T,)."""

    errors: FloatArray
    position_valid: BoolArray
    heading_valid: BoolArray


class TrajectoryScore(NamedTuple):
    """Absolute position error (no alignment) and heading error over the estimates that can be scored.

    A figure over no estimate at all is NaN.
    """

    position_rmse_m: float
    position_median_m: float
    position_p95_m: float
    heading_rmse_rad: float
    scored: int


def pose_errors(
    estimate: Trajectory, truth: Trajectory, *, heading_valid: BoolArray | None = None, max_gap: float = 0.5
) -> PoseErrors:
    """Return the error of each estimate against the truth, interpolated linearly to its stamp.

    The heading goes the short way round. An estimate before, after, or in a gap of the truth longer than
    ``max_gap`` seconds is not scored; ``heading_valid``, one flag a truth pose, takes the heading alone out
    wherever either neighbour is false. Raises ValueError when the truth has fewer than two poses.
    """
    stamps, known = estimate.stamps, truth.stamps
    if known.size < 2:
        raise ValueError(f"the truth has {known.size} poses; at least two are needed to interpolate")
    after = np.clip(np.searchsorted(known, stamps, side="left"), 1, known.size - 1)
    before = after - 1
    span = known[after] - known[before]
    fraction = np.clip((stamps - known[before]) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)
    step = truth.poses[:, after] - truth.poses[:, before]
    step[2] = wrap_angle(step[2])
    errors = estimate.poses - (truth.poses[:, before] + fraction * step)
    errors[2] = wrap_angle(errors[2])
    valid = (stamps >= known[0]) & (stamps <= known[-1]) & (span <= max_gap)
    flags = np.ones(known.size, dtype=np.bool_) if heading_valid is None else heading_valid
    return PoseErrors(errors, valid, valid & flags[before] & flags[after])


def thin(stamps: FloatArray, rate: float = 10.0) -> NDArray[np.intp]:
    """Return the index of the last stamp in each period of 1/``rate`` seconds, so that bursts do not count double."""
    if stamps.size == 0:
        return np.empty(0, dtype=np.intp)
    period = np.floor((stamps - stamps[0]) * rate)
    return np.flatnonzero(np.append(np.diff(period) > 0, True))


def score(
    estimate: Trajectory, truth: Trajectory, *, heading_valid: BoolArray | None = None, max_gap: float = 0.5
) -> TrajectoryScore:
    """Return RMSE, median and 95th percentile of the position error and the RMSE of the heading (see pose_errors)."""
    result = pose_errors(estimate, truth, heading_valid=heading_valid, max_gap=max_gap)
    distance = np.hypot(result.errors[0], result.errors[1])[result.position_valid]
    turned = result.errors[2][result.heading_valid]
    if distance.size == 0:
        return TrajectoryScore(np.nan, np.nan, np.nan, np.nan, 0)
    return TrajectoryScore(
        position_rmse_m=_rms(distance),
        position_median_m=float(np.median(distance)),
        position_p95_m=float(np.quantile(distance, 0.95)),
        heading_rmse_rad=_rms(turned) if turned.size else np.nan,
        scored=int(distance.size),
    )


def dead_reckoning(stamps: FloatArray, twists: FloatArray, start: Sequence[float]) -> Trajectory:
    """Return where odometry alone puts the robot: each twist (v, w) of shape (2, T) held until the next stamp."""
    duration = np.diff(stamps)
    arcs = arc_displacement(twists[0, :-1] * duration, twists[1, :-1] * duration)
    poses = np.empty((3, stamps.size))
    poses[:, 0] = start
    for k in range(duration.size):
        poses[:, k + 1] = compose(poses[:, k], arcs[:, k])
    return Trajectory(stamps, poses)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
