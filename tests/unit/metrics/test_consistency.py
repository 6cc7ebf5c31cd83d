"""Consistency: honest covariances are in their bands, boastful and timid ones are told apart."""

import math

import numpy as np
import pytest
from scipy.stats import binomtest, chi2

from dynpf.filters import kalman
from dynpf.filters.kalman import Gaussian
from dynpf.metrics.consistency import Verdict, coverage, mean_square, nees
from dynpf.rng import generator

CONSISTENT, OVERCONFIDENT, UNDERCONFIDENT = Verdict.CONSISTENT, Verdict.OVERCONFIDENT, Verdict.UNDERCONFIDENT
ROOT = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.05, 0.1]])


@pytest.mark.parametrize(
    ("scale", "verdict"), [(1.0, CONSISTENT), (0.5, OVERCONFIDENT), (0.8, OVERCONFIDENT), (1.25, UNDERCONFIDENT)]
)
def test_covariances_are_judged_by_the_errors(scale: float, verdict: Verdict) -> None:
    errors = ROOT @ generator(1, "test", 0).standard_normal((3, 1000))
    values = nees(errors, np.broadcast_to(scale * ROOT @ ROOT.T, (1000, 3, 3)))
    judged = mean_square(values, 3, 0.99)
    assert judged.verdict is verdict
    assert judged.figure == pytest.approx(
        np.einsum("dt,de,et->t", errors, np.linalg.inv(ROOT @ ROOT.T), errors).mean() / scale
    )
    assert judged.expected == 3.0
    assert judged.samples == 1000
    inside = coverage(values, 3, nominal=0.9, probability=0.99)
    assert inside.verdict is verdict
    assert inside.figure == np.mean(values <= chi2.ppf(0.9, 3))


def kalman_errors(seed: int, claimed: float) -> tuple[float, list[float]]:
    """Return NEES at the last of 30 steps and the NIS of each, of a constant velocity seen with noise of variance 0.5.

    The filter believes that the variance of the process noise is ``claimed`` times the true one.
    """
    rng = generator(seed, "test", 0)
    transition, observation, noise = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([[0.5]])
    process = 0.2 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    truth = rng.standard_normal(2)
    belief, surprises = Gaussian(np.zeros(2), np.eye(2)), []
    for _ in range(30):
        truth = transition @ truth + np.linalg.cholesky(process) @ rng.standard_normal(2)
        reading = observation @ truth + math.sqrt(0.5) * rng.standard_normal(1)
        belief = kalman.predict(belief, transition, claimed * process)
        spread = observation @ belief.covariance @ observation.T + noise
        surprises.append(nees((reading - observation @ belief.mean)[:, None], spread[None])[0])
        belief = kalman.update(belief, reading, observation, noise)
    return nees((belief.mean - truth)[:, None], belief.covariance[None])[0], surprises


@pytest.mark.parametrize(("claimed", "verdict"), [(1.0, CONSISTENT), (0.05, OVERCONFIDENT), (20.0, UNDERCONFIDENT)])
def test_filters_are_judged_over_seeds(claimed: float, verdict: Verdict) -> None:
    runs = [kalman_errors(seed, claimed) for seed in range(100)]
    squares = np.array([square for square, _ in runs])
    surprises = np.concatenate([nis for _, nis in runs])
    assert mean_square(squares, 2, 0.99).verdict is verdict
    assert mean_square(surprises, 1, 0.99).verdict is verdict
    assert coverage(squares, 2, probability=0.99).verdict is (verdict if claimed < 1.0 else CONSISTENT)
    assert coverage(squares, 2, nominal=0.6, probability=0.99).verdict is verdict


def test_the_band_holds_as_often_as_it_says() -> None:
    values = np.random.default_rng(2).chisquare(3, (4000, 20))
    judged = [mean_square(row, 3, 0.9).verdict for row in values]
    assert np.mean([one is CONSISTENT for one in judged]) == pytest.approx(0.9, abs=0.02)
    assert np.mean([one is OVERCONFIDENT for one in judged]) == pytest.approx(0.05, abs=0.015)


def test_readings_of_different_sizes_are_judged_together() -> None:
    judged = mean_square(np.array([2.0, 4.0, 9.0]), np.array([2, 4, 6]))
    assert judged.expected == 4.0
    assert judged.figure == 5.0
    assert (judged.low, judged.high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 12) / 3))
    inside = coverage(np.array([5.0, 5.0]), np.array([1, 6]), nominal=0.9)
    assert inside.figure == 0.5


@pytest.mark.parametrize("trials", [12, 40, 1000])
def test_a_share_is_in_the_band_just_when_its_wilson_interval_holds_the_nominal(trials: int) -> None:
    verdicts = set()
    for hits in np.unique(np.linspace(0, trials, 60).astype(int)):
        values = np.where(np.arange(trials) < hits, 0.0, 100.0)
        interval = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
        verdict = coverage(values, 1, nominal=0.6).verdict
        assert (verdict is OVERCONFIDENT) == (interval.high < 0.6)
        assert (verdict is UNDERCONFIDENT) == (interval.low > 0.6)
        verdicts.add(verdict)
    assert len(verdicts) == 3


def test_a_singular_covariance_is_not_a_number_and_not_judged() -> None:
    values = nees(np.ones((3, 2)), np.stack((np.eye(3), np.zeros((3, 3)))))
    assert values[0] == pytest.approx(3.0)
    assert math.isnan(values[1])
    assert mean_square(values, 3).samples == coverage(values, 3).samples == 1
    for judge in (mean_square, coverage):
        with pytest.raises(ValueError, match="no value to judge"):
            judge(values[1:], 3)
