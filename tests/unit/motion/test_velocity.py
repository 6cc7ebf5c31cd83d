"""The velocity model: the textbook's arc, and no trouble where it turns into a straight line."""

import numpy as np
import pytest

from dynpf.motion import Twist, Velocity, VelocityParams
from dynpf.rng import Stream

STREAM = Stream.of(1, "test", 0, "motion")
NOISELESS = VelocityParams(alpha_1=0.0, alpha_2=0.0, alpha_3=0.0, alpha_4=0.0, alpha_5=0.0, alpha_6=0.0)


def test_the_end_of_the_arc_is_the_textbooks() -> None:
    v, w, duration, theta = 0.8, 0.6, 1.5, 0.4
    x = 1.0 - v / w * np.sin(theta) + v / w * np.sin(theta + w * duration)
    y = 2.0 + v / w * np.cos(theta) - v / w * np.cos(theta + w * duration)
    start = np.array([[1.0], [2.0], [theta]])
    moved = Velocity(NOISELESS).propagate(start, Twist(v, w, duration), STREAM)
    assert moved[:, 0] == pytest.approx([x, y, theta + w * duration], abs=1e-6)


@pytest.mark.parametrize("w", [0.0, 1e-300, 1e-12, -1e-7, 1e-4, 2.1e-3])
def test_the_arc_turns_into_a_line_without_a_jump(w: float) -> None:
    start, twist = np.array([[0.0], [0.0], [0.3]]), Twist(2.0, w, 1.0)
    # The end of an arc of little turn, by its series: half the turn off the heading.
    end = [2.0 * np.cos(0.3 + w / 2), 2.0 * np.sin(0.3 + w / 2), 0.3 + w]
    for moved in (Velocity(NOISELESS).propagate(start, twist, STREAM), Velocity(NOISELESS).expected(start, twist)):
        assert moved[:, 0] == pytest.approx(end, abs=w**2 / 10 + 3e-7)


def test_the_final_rotation_turns_a_robot_without_moving_it() -> None:
    only_final = VelocityParams(alpha_1=0.0, alpha_2=0.0, alpha_3=0.0, alpha_4=0.0, alpha_5=0.25, alpha_6=0.0)
    start = np.zeros((3, 20_000))
    moved = Velocity(only_final).propagate(start, Twist(1.0, 0.0, 0.2), STREAM)
    assert np.all(moved[0] == np.float32(0.2))
    assert np.all(moved[1] == 0.0)
    # Standard deviation sqrt(0.25 * 1) rad/s over 0.2 s: alpha is a factor of the variance.
    assert moved[2].std() == pytest.approx(0.1, rel=5 / 200)
