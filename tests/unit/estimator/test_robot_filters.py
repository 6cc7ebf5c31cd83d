"""The robot's filter by name: each tracks as well as the Kalman filter, and says honestly how well."""

import math

import numpy as np
import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.parts.config import FilterName, RearrangementConfig
from dynpf_systems.parts.robot_filters import Belief, Seen, fused, robot_filter

from dynpf.metrics.consistency import nees
from dynpf.metrics.rearrangement import robot_bound
from dynpf.rng import Stream

PROCESS, MEASURED = 0.06e-4, 5e-4
NAMES: tuple[FilterName, ...] = (
    *("optimal", "prior", "auxiliary", "local_linearization"),
    *("extended_kalman", "unscented_kalman"),
)


def track(name, *, n=400, ticks=150, seed=3):
    """Errors (T, 2) and covariances (T, 2, 2) of a robot that goes as commanded, and is seen at every tick."""
    random = np.random.default_rng(seed)
    chosen = robot_filter(RearrangementConfig(filter=name, n=n))
    robot, shift = np.zeros(2), np.array([0.01, -0.005])
    beliefs: list[Belief] = []
    errors = []
    for tick in range(ticks):
        seen = Seen(robot + math.sqrt(MEASURED) * random.standard_normal(2), MEASURED)
        stream = Stream.of(seed, "test", tick)
        beliefs.append(
            chosen.step(beliefs[-1], shift, PROCESS, seen, stream) if beliefs else chosen.start(seen, stream)
        )
        errors.append(beliefs[-1].mean - robot)
        robot = robot + shift + math.sqrt(PROCESS) * random.standard_normal(2)
    return np.array(errors), np.array([one.covariance for one in beliefs])


@pytest.mark.parametrize("name", NAMES)
def test_each_filter_is_near_the_kalman_filter(name):
    errors, covariances = track(name)
    best, _ = track("extended_kalman")
    # Blind particles in such small motions are poorer than a Gaussian: they are compared more loosely.
    apart = 0.35 if name in {"prior", "auxiliary"} else 0.15
    assert np.sqrt(np.mean((errors - best)[20:] ** 2)) < apart * np.sqrt(np.mean(best[20:] ** 2))
    bound = robot_bound(np.full(len(errors), 1.0 / MEASURED), PROCESS).noisy
    assert np.mean(np.trace(covariances[20:], axis1=1, axis2=2) / bound[20:] ** 2) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("name", ["extended_kalman", "unscented_kalman"])
def test_kalman_filters_have_the_covariance_of_the_bound(name):
    _, covariances = track(name, ticks=30)
    bound = robot_bound(np.full(30, 1.0 / MEASURED), PROCESS).noisy
    np.testing.assert_allclose(np.trace(covariances, axis1=1, axis2=2), bound**2, rtol=1e-9)


def test_a_small_cloud_does_not_claim_to_know_its_covariance():
    """NEES averages 2; with the covariance of the draws as it is, it would be 7 % more."""
    values = []
    for seed in range(12):
        errors, covariances = track("optimal", n=100, ticks=120, seed=seed)
        values.append(nees(errors[20:].T, covariances[20:]))
    assert 1.75 < np.mean(values) < 2.3


def test_without_a_sight_the_belief_moves_and_widens():
    for name in NAMES:
        chosen = robot_filter(RearrangementConfig(filter=name))
        belief = chosen.start(Seen(np.zeros(2), MEASURED), Stream.of(1, "test", 0))
        later = chosen.step(belief, np.array([0.1, 0.0]), PROCESS, None, Stream.of(1, "test", 1))
        np.testing.assert_allclose(later.mean - belief.mean, [0.1, 0.0], atol=2e-3)
        assert belief.variance < later.variance or name in NAMES[:4]


def test_two_sights_are_one_with_the_sum_of_their_information():
    one, other = Seen(np.array([0.0, 1.0]), 2.0), Seen(np.array([3.0, 1.0]), 1.0)
    together = fused([one, other])
    assert together is not None
    np.testing.assert_allclose(together.position, [2.0, 1.0])
    assert together.variance == pytest.approx(2.0 / 3.0)
    assert fused([]) is None
    assert fused([one]) is one


def test_what_is_shown_stands_for_the_posterior():
    chosen = robot_filter(RearrangementConfig(n=4000))
    belief = chosen.start(Seen(np.array([1.0, 2.0]), 1e-4), Stream.of(1, "test", 0))
    assert belief.shown.shape == (2, 200)
    np.testing.assert_allclose(belief.shown.mean(axis=1), [1.0, 2.0], atol=3e-3)
    gaussian = Belief(np.array([1.0, 2.0]), np.diag([1e-4, 4e-4]))
    np.testing.assert_allclose(np.cov(gaussian.shown[:, 1:], bias=True), gaussian.covariance, atol=1e-12)


def test_a_scenario_names_the_filter():
    scenario = load_scenario("parts-3-tracked", overrides=["estimator.filter=unscented_kalman"])
    assert scenario.estimator.filter == "unscented_kalman"
    with pytest.raises(ScenarioError, match="did you mean 'unscented_kalman'"):
        load_scenario("parts-3-tracked", overrides=["estimator.filter=unscented"])
