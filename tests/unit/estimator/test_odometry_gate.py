"""Odometry that is finite and wrong: it is left out and told, and the estimate goes on as good as without it."""

import math
from collections.abc import Sequence

import pytest
from dynpf_protocol.messages import Estimate, Log, Message, Odometry, OdometryPose
from dynpf_runtime.node import Step, decode_state, encode_state

from tests.unit.estimator.test_localization import NOISELESS, SECOND, circle, node, of_type, received

RUBBISH = [1.0001644e256, -1.7e308, 1e154, 1e39, 1e6]


def pose(t: float, **changes: float) -> OdometryPose:
    x, y, theta = circle(t)
    return OdometryPose(**{"x": x, "y": y, "theta": theta, **changes})


def driven(messages: Sequence[Message]) -> tuple[Estimate, list[str]]:
    """Return the last estimate and what was logged on the way; half way the node is frozen and thawed."""
    estimator, logged = node(motion=NOISELESS, calibration=None), []
    for k, message in enumerate(messages):
        if k == len(messages) // 2:
            state = decode_state(encode_state(estimator.freeze()))
            estimator = node(motion=NOISELESS, calibration=None)
            estimator.thaw(state)
        one = received(0.1 * k, message)._replace(topic="sensors/odometry")
        outputs = estimator.step(Step(k, k, round(0.1 * k * SECOND), (one,))).outputs
        logged += [log.message for log in of_type(outputs, Log)]
    (estimate,) = of_type(outputs, Estimate)
    return estimate, logged


@pytest.mark.parametrize("wrong", RUBBISH)
@pytest.mark.parametrize("place", [5, 19, 20])
def test_one_broken_pose_costs_nothing(wrong: float, place: int) -> None:
    sound, nothing = driven([pose(0.1 * k) for k in range(40)])
    estimate, logged = driven([pose(0.1 * k, **({"x": wrong} if k == place else {})) for k in range(40)])
    assert math.hypot(estimate.x - sound.x, estimate.y - sound.y) < 1e-3
    assert nothing == []
    assert len(logged) == 1
    assert "is left out" in logged[0]


@pytest.mark.parametrize("wrong", RUBBISH)
def test_a_first_pose_that_is_broken_costs_the_way_to_the_second(wrong: float) -> None:
    sound, _ = driven([pose(0.1 * k) for k in range(1, 40)])
    estimate, _ = driven([pose(0.1 * k, **({"x": wrong} if k == 0 else {})) for k in range(40)])
    assert math.hypot(estimate.x - sound.x, estimate.y - sound.y) < 0.1


def test_odometry_that_was_set_anew_goes_on() -> None:
    estimate, logged = driven([pose(0.1 * k, **({"x": 1e5} if k >= 20 else {})) for k in range(40)])
    assert math.isfinite(estimate.x)
    assert len(logged) == 1
    moved = math.hypot(estimate.x, estimate.y)
    assert 0.5 < moved < 3.0


@pytest.mark.parametrize("wrong", RUBBISH)
def test_a_broken_twist_is_left_out(wrong: float) -> None:
    sound, _ = driven([Odometry(v=0.5, w=0.5)] * 40)
    broken = [Odometry(v=wrong, w=0.5) if k % 4 == 3 else Odometry(v=0.5, w=0.5) for k in range(40)]
    estimate, logged = driven(broken)
    assert (estimate.x, estimate.y) == (sound.x, sound.y)
    assert [text.rpartition("; ")[2] for text in logged] == ["1 so far", "10 so far"]
