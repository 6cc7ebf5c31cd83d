"""Headings by a gyro, distances by the wheels."""

import math

import pytest
from dynpf_formats.ros2.gyro import GyroHeading

SECOND = 10**9


def driven(wheel_turn: float, rate: float, *, bias: float = 0.0, still_s: float = 0.0, pause_s: float = 0.0):
    """Return the last pose after an arc of radius 2 m and 1 rad in a second, by wheels that misjudge turns."""
    gyro, pose, wheels = GyroHeading(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    still = round(still_s * 100)
    for step in range(still + 101):
        at_ns = step * SECOND // 100
        moving = step > still
        if not (moving and (step - still) * 0.01 < pause_s):
            gyro.take(at_ns, (rate if moving else 0.0) + bias)
        if moving:
            turn = 0.01 * wheel_turn
            x, y, theta = wheels
            chord, along = 2.0 * 0.01, theta + turn / 2
            wheels = x + chord * math.cos(along), y + chord * math.sin(along), theta + turn
        pose = gyro.corrected(at_ns, wheels)
    return pose


ARC = (2.0 * math.sin(1.0), 2.0 - 2.0 * math.cos(1.0), 1.0)


def test_turns_are_the_gyros_and_distances_the_wheels():
    assert driven(1.3, 1.0, still_s=1.0) == pytest.approx(ARC, abs=0.02)
    assert driven(1.3, 1.3, still_s=1.0) != pytest.approx(ARC, abs=0.2)  # what the wheels would make of it


def test_what_the_gyro_says_while_the_wheels_stand_is_its_bias():
    assert driven(1.3, 1.0, bias=0.2, still_s=1.0) == pytest.approx(ARC, abs=0.02)
    assert driven(1.3, 1.0, bias=0.2) != pytest.approx(ARC, abs=0.1)


def test_where_the_gyro_pauses_the_wheels_turn():
    assert driven(1.0, 7.0, still_s=0.5, pause_s=1.1) == pytest.approx(ARC, abs=0.1)


def test_without_rates_the_poses_are_the_wheels():
    gyro = GyroHeading()
    assert gyro.corrected(0, (1.0, 2.0, 0.5)) == (1.0, 2.0, 0.5)
    assert gyro.corrected(SECOND, (2.0, 2.0, 0.7)) == pytest.approx((2.0, 2.0, 0.7))
