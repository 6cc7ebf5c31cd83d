"""Heading faults: a swap of markers is found to its edges; sharp turns, stops, gaps and reversing are none."""

import math

import numpy as np
import pytest
from dynpf_formats.importers.heading import heading_faults
from numpy.typing import NDArray

from dynpf.se2 import arc_displacement, compose

Floats = NDArray[np.float64]

RATE = 50.0


def arc(pose: tuple[float, float, float], v: float, w: float, seconds: float) -> tuple[float, float, float]:
    x, y, theta = compose(np.array(pose), arc_displacement(v * seconds, w * seconds)).tolist()
    return x, y, theta


def trajectory(*legs: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """Return times and poses of a robot driving each leg: speed, turning rate, seconds."""
    poses = [(0.0, 0.0, 0.0)]
    for v, w, seconds in legs:
        for _ in range(round(seconds * RATE)):
            poses.append(arc(poses[-1], v, w, 1 / RATE))
    return np.arange(len(poses)) / RATE, np.array(poses)


def faults(time: Floats, pose: Floats, *, backwards: bool = False) -> list[tuple[float, float]]:
    found = heading_faults(time, pose, np.full(len(time), backwards))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]]).astype(int)))
    return [(time[a], time[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def swap(time: Floats, pose: Floats, start: float, end: float, angle: float = 2.1) -> Floats:
    swapped: Floats = pose + np.where((time >= start) & (time < end), angle, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    return swapped


DRIVE = ((0.15, 0.0, 20.0), (0.1, 0.6, 10.0), (0.15, 0.0, 20.0))


@pytest.mark.parametrize("angle", [2.1, -2.1, math.pi, 0.9])
def test_a_swap_is_found_to_half_a_chord(angle: float) -> None:
    time, pose = trajectory(*DRIVE)
    assert faults(time, pose) == []
    ((start, end),) = faults(time, swap(time, pose, 15.0, 35.0, angle))
    assert start == pytest.approx(14.5, abs=0.05)
    assert end == pytest.approx(35.5, abs=0.05)


def test_two_swaps_with_good_heading_between_are_two() -> None:
    time, pose = trajectory(*DRIVE)
    twice = swap(time, swap(time, pose, 5.0, 10.0), 15.0, 20.0)
    assert [(round(a, 1), round(b, 1)) for a, b in faults(time, twice)] == [(4.5, 10.5), (14.5, 20.5)]


def test_a_moment_is_no_fault() -> None:
    time, pose = trajectory(*DRIVE)
    assert faults(time, swap(time, pose, 15.0, 16.0)) == []


def test_a_robot_that_stands_in_mid_fault_is_at_fault_throughout() -> None:
    time, pose = trajectory((0.15, 0.0, 10.0), (0.0, 0.0, 30.0), (0.15, 0.0, 10.0))
    ((start, end),) = faults(time, swap(time, pose, 5.0, 45.0))
    assert (start, end) == pytest.approx((4.5, 45.5), abs=0.05)


def test_standing_and_turning_on_the_spot_are_no_fault() -> None:
    time, pose = trajectory((0.15, 0.0, 5.0), (0.0, 1.5, 10.0), (0.0, 0.0, 10.0), (0.15, 0.0, 5.0))
    assert faults(time, pose) == []


def test_gaps_in_which_the_robot_turned_are_no_fault() -> None:
    time, pose = trajectory(*DRIVE)
    kept = (time < 19.0) | (time > 24.0)
    assert faults(time[kept], pose[kept]) == []


def test_reversing_is_a_fault_only_for_a_robot_that_does_not_say_so() -> None:
    time, pose = trajectory((-0.15, 0.1, 20.0))
    assert faults(time, pose, backwards=True) == []
    ((start, end),) = faults(time, pose)
    assert start == 0.0
    assert end == pytest.approx(20.0)


def test_nothing_or_a_single_sample_is_no_fault() -> None:
    assert faults(np.empty(0), np.empty((0, 3))) == []
    assert faults(np.zeros(1), np.zeros((1, 3))) == []
