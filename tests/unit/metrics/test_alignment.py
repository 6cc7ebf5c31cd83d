"""The rigid motion between an estimate and its reference, where it is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.metrics.alignment import alignment, moved_into
from dynpf.metrics.trajectory import Trajectory, pose_errors
from dynpf.se2 import compose

STAMPS = np.arange(0.0, 20.0, 0.1)
PATH = np.stack((3.0 * np.sin(0.3 * STAMPS), 0.4 * STAMPS, 0.2 * STAMPS))
METRES = st.floats(-1e3, 1e3)


@settings(deadline=None, max_examples=30)  # the first example compiles kernels
@given(METRES, METRES, st.floats(-3.1, 3.1))
def test_the_offset_between_two_frames_is_found_and_undone(x: float, y: float, theta: float) -> None:
    offset = (x, y, theta)
    reference = np.stack([compose(np.array(offset), pose) for pose in PATH.T], axis=1)
    estimate = Trajectory(STAMPS, PATH)
    found = alignment(estimate, pose_errors(estimate, Trajectory(STAMPS, reference)))
    assert found is not None
    assert found.offset == pytest.approx(offset, abs=1e-8)
    assert found.position_rmse_m == pytest.approx(0.0, abs=1e-8)
    assert found.heading_rmse_rad == pytest.approx(0.0, abs=1e-8)
    assert moved_into(reference, offset)[:2] == pytest.approx(PATH[:2], abs=1e-8)


def test_no_other_rigid_motion_leaves_less() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.3, PATH.shape)
    estimate, reference = Trajectory(STAMPS, PATH + noise), Trajectory(STAMPS, PATH)
    found = alignment(estimate, pose_errors(estimate, reference))
    assert found is not None

    def left(offset: tuple[float, ...]) -> float:
        moved = moved_into(PATH, (offset[0], offset[1], offset[2]))
        return float(np.sqrt(np.mean(np.sum((moved - estimate.poses)[:2] ** 2, axis=0))))

    assert left(found.offset) == pytest.approx(found.position_rmse_m)
    for change in np.eye(3):
        for sign in (-0.01, 0.01):
            assert left(tuple(np.array(found.offset) + sign * change)) > found.position_rmse_m


def test_two_poses_are_needed() -> None:
    estimate = Trajectory(STAMPS[:1], PATH[:, :1])
    assert alignment(estimate, pose_errors(estimate, Trajectory(STAMPS, PATH))) is None


def test_a_filter_that_was_lost_for_a_while_does_not_change_the_frames() -> None:
    lost = PATH.copy()
    lost[:2, :40] += 12.0
    estimate = Trajectory(STAMPS, moved_into(lost, (-14.0, 3.0, 0.5)))
    found = alignment(estimate, pose_errors(estimate, Trajectory(STAMPS, PATH)))
    assert found is not None
    assert found.offset == pytest.approx((-14.0, 3.0, 0.5), abs=1e-8)
    assert found.position_median_m == pytest.approx(0.0, abs=1e-8)
    assert found.position_rmse_m == pytest.approx(np.hypot(12.0, 12.0) * np.sqrt(40 / STAMPS.size))
