"""The capsule's step: COLON's path, and noise on every step."""

import math

import numpy as np
import pytest

from dynpf.motion import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.rng import Stream

# COLON's fifteen motions lead from (150, 370, 0) to (820, 410, pi/2).
MOTIONS = [(100, 0)] * 4 + [(50, 0)] * 3 + [(20, 0)] * 3 + [(10, 0), (20, 0), (30, 0), (20, math.pi / 2), (20, 0)]


def test_without_noise_the_capsule_ends_where_the_source_says() -> None:
    model = CapsuleStep(CapsuleStepParams(sigma=0.0, sigma_theta=0.0))
    pose = np.array([[150.0], [370.0], [0.0]])
    drawn = pose
    for number, motion in enumerate(MOTIONS):
        pose = model.expected(pose, CapsuleMotion(*motion))
        drawn = model.propagate(drawn, CapsuleMotion(*motion), Stream.of(1, "test", number))
    assert pose[:, 0] == pytest.approx([820.0, 410.0, math.pi / 2], abs=1e-9)
    assert drawn[:, 0] == pytest.approx([820.0, 410.0, math.pi / 2], abs=1e-4)


def test_a_step_of_no_length_is_noisy_too_by_standard_deviations() -> None:
    start = np.zeros((3, 20_000))
    moved = CapsuleStep(CapsuleStepParams()).propagate(start, CapsuleMotion(0.0, 0.0), Stream.of(1, "test", 0))
    assert moved.std(axis=1) == pytest.approx([0.1, 0.1, 0.1], rel=5 / 200)
