"""Circle fits against exact points, invariance, and a brute-force optimum."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from dynpf import rng
from dynpf.vision.circle import fit_circle, fit_circles, fit_circles_algebraic

coordinate = st.floats(-100, 100)


def arc(x: float, y: float, radius: float, start: float, length: float) -> np.ndarray:
    angle = start + np.linspace(0, length, 25)
    return np.array([x, y]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@settings(derandomize=True, deadline=None)
@given(coordinate, coordinate, st.floats(0.05, 50), st.floats(0, 6.28), st.floats(0.8, 6.0))
def test_exact_points_give_the_exact_circle(x: float, y: float, radius: float, start: float, length: float) -> None:
    found = fit_circle(arc(x, y, radius, start, length))
    assert found == pytest.approx((x, y, radius, 0.0), abs=1e-8 * (1 + radius))


@settings(derandomize=True, deadline=None, max_examples=50)
@given(coordinate, coordinate, st.floats(0, 6.28), st.floats(0.1, 20))
def test_fit_moves_turns_and_scales_with_its_points(x: float, y: float, turn: float, scale: float) -> None:
    points = arc(0.3, -0.2, 1.0, 0.5, 4.0) + 0.02 * rng.generator(1, "test", 0).standard_normal((25, 2))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    *centre, radius, residual = fit_circle(points)
    moved = fit_circle(scale * points @ rotation.T + [x, y])
    expected = scale * rotation @ centre + [x, y]
    assert moved == pytest.approx((*expected, scale * radius, scale * residual), abs=1e-6 * scale)
    assert residual > 0.005


def test_fit_minimizes_the_geometric_distance() -> None:
    points = arc(2.0, 1.0, 3.0, 0.2, 1.6) + 0.1 * rng.generator(2, "test", 0).standard_normal((25, 2))

    def cost(circle: np.ndarray) -> float:
        return float(((np.hypot(*(points - circle[:2]).T) - circle[2]) ** 2).sum())

    best = minimize(cost, [2.0, 1.0, 3.0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-14})
    start = fit_circles_algebraic(points[None], np.ones((1, 25)))[0]
    found = np.array(fit_circle(points)[:3])
    assert found == pytest.approx(best.x, abs=1e-5)
    assert cost(start) > cost(found)  # the algebraic fit alone is not the optimum


def test_weights_choose_the_points_of_each_circle() -> None:
    first, second = arc(0, 0, 1, 0, 6), arc(5, 1, 2, 1, 4)
    points = np.concatenate([first, second])[None]
    weights = np.repeat(np.eye(2), 25, axis=1)
    circles, residual = fit_circles(points, weights, fit_circles_algebraic(points, weights))
    assert circles == pytest.approx(np.array([[0, 0, 1], [5, 1, 2]]), abs=1e-9)
    assert residual == pytest.approx([0, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        (np.zeros((2, 2)), "at least 3 points"),
        (np.stack([np.arange(5.0), 2 * np.arange(5.0)], axis=1), "one line"),
        (np.ones((4, 2)), "one line"),
        (np.array([[0, 0], [1, 0], [np.nan, 1]]), "finite"),
    ],
)
def test_refuses_points_that_fix_no_circle(points: np.ndarray, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        fit_circle(points)
