"""Where a reference trajectory's heading contradicts its own direction of travel.

A motion-capture system that swaps two markers of a robot keeps its position and turns its heading by a fixed angle for
as long as the swap lasts. A wheeled robot cannot drive sideways: where it seems to, the heading is wrong.
"""

import numpy as np
from numpy.typing import NDArray

from dynpf.portable import atan2, hypot
from dynpf.types import FloatArray

__all__ = ["heading_faults"]

Bools = NDArray[np.bool_]

HALF_CHORD_S = 0.5  # the direction of travel at t is that of the chord from t - 0.5 s to t + 0.5 s
SHORTEST_CHORD_M = 0.05  # a slower robot's direction of travel is noise
GAP_S = 0.5  # no chord spans a gap of the reference
SUSPECT_RAD = 0.7  # turning sharply, or with an outlier in the position, a robot stays below it
SHORTEST_FAULT_S = 2.0  # anything shorter is an outlier in the position, not a fault of the heading
HEALTHY_S = 2.0  # a fault ends only where the heading is good for so long


def heading_faults(time: FloatArray, pose: FloatArray, backwards: Bools) -> Bools:
    """Return for each of the N samples whether its heading is faulty.

    ``time`` (N,) in seconds, not decreasing; ``pose`` (N, 3) is x, y in metres and theta in radians; ``backwards`` (N,)
    marks where the robot drives in reverse. A fault is a stretch of at least two seconds whose heading is more than
    0.7 rad off the direction of travel. It includes the adjoining samples at which the robot hardly moves, and half a
    chord on either side, within which the direction of travel is unknown.
    """
    if len(time) == 0:
        return np.zeros(0, dtype=bool)
    offset, moving = _offset(time, pose, backwards)
    evidence = np.flatnonzero(moving)
    suspects = np.flatnonzero(np.abs(offset[evidence]) > SUSPECT_RAD)
    faults = np.zeros(len(time), dtype=bool)
    for first, last in _runs(time[evidence], suspects):
        if time[evidence[last]] - time[evidence[first]] < SHORTEST_FAULT_S:
            continue
        start = evidence[first - 1] + 1 if first > 0 else 0
        end = evidence[last + 1] - 1 if last + 1 < len(evidence) else len(time) - 1
        faults |= (time >= time[start] - HALF_CHORD_S) & (time <= time[end] + HALF_CHORD_S)
    return faults


def _offset(time: FloatArray, pose: FloatArray, backwards: Bools) -> tuple[FloatArray, Bools]:
    """Return heading minus direction of travel in [-pi, pi), and where the robot moves enough to define it."""
    piece = np.concatenate([[0], np.cumsum(np.diff(time) > GAP_S)])
    first, last = np.searchsorted(piece, piece), np.searchsorted(piece, piece, side="right") - 1
    before = np.maximum(np.searchsorted(time, time - HALF_CHORD_S), first)
    after = np.minimum(np.searchsorted(time, time + HALF_CHORD_S, side="right") - 1, last)
    chord = pose[after, :2] - pose[before, :2]
    travel = atan2(chord[:, 1], chord[:, 0]) + np.where(backwards, np.pi, 0.0)
    offset = np.mod(pose[:, 2] - travel + np.pi, 2 * np.pi) - np.pi
    return offset, hypot(chord[:, 0], chord[:, 1]) >= SHORTEST_CHORD_M


def _runs(time: FloatArray, suspects: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Return first and last index of each run of suspects, joined across less than HEALTHY_S of good heading.

    ``time`` is that of the samples in which the robot moves: standing still neither ends nor extends a run.
    """
    if len(suspects) == 0:
        return []
    moved = np.concatenate([[0.0], np.cumsum(np.minimum(np.diff(time), GAP_S))])
    cuts = np.flatnonzero(np.diff(moved[suspects]) > HEALTHY_S)
    starts = np.concatenate([[0], cuts + 1])
    ends = np.concatenate([cuts, [len(suspects) - 1]])
    return [(int(suspects[start]), int(suspects[end])) for start, end in zip(starts, ends, strict=True)]
