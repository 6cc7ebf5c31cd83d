"""Motion along a velocity field: Euler's step, its derivative, and noise where it belongs."""

import numpy as np
import pytest

from dynpf.motion import GradientFlow, GradientFlowParams
from dynpf.rng import Stream
from dynpf.se2 import Floats

STREAM = Stream.of(1, "test", 0, "motion")


def to_origin(states: Floats) -> Floats:
    """Descend half the squared distance: the velocity is minus the state."""
    return -states


def test_descent_to_the_origin_shrinks_states_and_its_derivative() -> None:
    model = GradientFlow(GradientFlowParams(variance=0.0), to_origin)
    states = np.array([[1.0, -2.0], [0.5, 4.0]])
    assert model.expected(states, 0.25) == pytest.approx(0.75 * states, abs=1e-15)
    assert np.array_equal(model.propagate(states, 0.25, STREAM), model.expected(states, 0.25))
    assert model.jacobian(states, 0.25) == pytest.approx(np.repeat(0.75 * np.eye(2)[:, :, None], 2, axis=2), abs=1e-9)


def test_derivative_of_single_precision_states_is_taken_in_double() -> None:
    model = GradientFlow(GradientFlowParams(), lambda states: np.sin(3.0 * states))
    states = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 50)).astype(np.float32)
    slope = 1.0 + 0.5 * 3.0 * np.cos(3.0 * states.astype(np.float64))
    found = model.jacobian(states, 0.5)
    assert found[[0, 1], [0, 1]] == pytest.approx(slope, abs=1e-6)
    assert not found[[0, 1], [1, 0]].any()


def test_positions_get_the_variance_of_the_source_and_headings_their_own() -> None:
    still = np.zeros_like
    for params, rows, variances in (
        (GradientFlowParams(), 2, [6e-6, 6e-6]),
        (GradientFlowParams(), 3, [6e-6, 6e-6, 0.0]),
        (GradientFlowParams(turn_variance=0.01), 4, [6e-6, 6e-6, 0.01, 0.0]),
    ):
        moved = GradientFlow(params, still).propagate(np.zeros((rows, 50_000)), 0.1, STREAM)
        assert moved.var(axis=1) == pytest.approx(variances, rel=5 * np.sqrt(2) / 223)
