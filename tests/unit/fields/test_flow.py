"""The velocity field of a robot that descends a potential."""

import numpy as np
import pytest

from dynpf.fields.flow import DescentFlow, DescentFlowParams
from dynpf.types import FloatArray

PARAMS = DescentFlowParams(goal=(1.0, 0.2), speed=0.3, slow_distance=0.1, discs=((0.4, 0.0, 0.08), (0.7, 0.4, 0.06)))
FLOW = DescentFlow(PARAMS)


def potential(place: tuple[float, float] | FloatArray) -> float:
    """The textbook's gamma^k / beta, as a logarithm."""
    away = np.hypot(place[0] - PARAMS.goal[0], place[1] - PARAMS.goal[1])
    total = PARAMS.exponent * np.log(away**2)
    for x, y, radius in PARAMS.discs:
        total -= np.log((place[0] - x) ** 2 + (place[1] - y) ** 2 - (PARAMS.robot_radius + radius) ** 2)
    return float(total)


@pytest.mark.parametrize("place", [(-0.5, 0.1), (0.2, 0.3), (0.4, -0.3), (0.95, 0.2)])
def test_it_goes_down_the_potential_at_the_speed_that_is_asked_for(place: tuple[float, float]) -> None:
    step = 1e-6
    gradient = np.array(
        [
            (potential(np.add(place, shift)) - potential(np.subtract(place, shift))) / (2.0 * step)
            for shift in (np.array([step, 0.0]), np.array([0.0, step]))
        ]
    )
    speed = PARAMS.speed * min(1.0, np.hypot(place[0] - 1.0, place[1] - 0.2) / PARAMS.slow_distance)
    expected = -gradient / np.linalg.norm(gradient) * speed
    np.testing.assert_allclose(FLOW(np.array([place]).T)[:, 0], expected, rtol=1e-6)


def test_a_robot_arrives_and_touches_nothing() -> None:
    place = np.array([[-0.5], [0.05], [2.0]])
    for _ in range(400):
        place = place + 0.05 * FLOW(place)
        for x, y, radius in PARAMS.discs:
            assert np.hypot(place[0, 0] - x, place[1, 0] - y) > PARAMS.robot_radius + radius
    np.testing.assert_allclose(place[:, 0], [1.0, 0.2, 2.0], atol=1e-3)


def test_inside_of_a_disc_and_at_the_goal_it_is_finite() -> None:
    velocities = FLOW(np.array([[0.4, 1.0, 0.41], [0.0, 0.2, 0.0]], dtype=np.float32))
    assert velocities.dtype == np.float32
    assert np.isfinite(velocities).all()
    np.testing.assert_allclose(velocities[:, 1], 0.0, atol=1e-5)  # 0.2 has no float32 of its own
    assert velocities[0, 2] > 0.0  # out of the disc, on the side where it is


def test_a_parameter_out_of_its_range_is_named() -> None:
    with pytest.raises(ValueError, match=r"DescentFlowParams\.speed = 0\.0"):
        DescentFlow(DescentFlowParams(goal=(0.0, 0.0), speed=0.0))
