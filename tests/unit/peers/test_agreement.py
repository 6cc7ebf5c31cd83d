"""Ours against other libraries on the same numbers. Without their environment these are skipped."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynpf_lab.bench.peers import PEERS_PYTHON
from dynpf_lab.bench.problems import ALPHA, SIGMA_BEARING, SIGMA_RANGE_M, LandmarkProblem

from dynpf.filters import kalman
from dynpf.filters.cloud import effective_sample_size
from dynpf.filters.extended import ExtendedKalman
from dynpf.filters.kalman import Gaussian
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.resampling import Stratified, systematic
from dynpf.filters.unscented import UnscentedKalman, UnscentedKalmanParams
from dynpf.maps.landmarks import LandmarkMap
from dynpf.measurement.linear import LinearMeasurement, Observation
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.rng import Stream

pytestmark = pytest.mark.skipif(not PEERS_PYTHON.exists(), reason="no other libraries here: make peers")

STEPS = 9
N = 20_000
UNSCENTED = {"alpha": 0.8, "beta": 2.0, "kappa": 0.5}


def linear() -> dict[str, Any]:
    """Return a target of nearly constant velocity in the plane whose position is read."""
    f = np.eye(4)
    f[0, 2] = f[1, 3] = 0.5
    q = np.diag([0.02, 0.02, 0.05, 0.05])
    q[0, 2] = q[2, 0] = q[1, 3] = q[3, 1] = 0.01
    r = np.array([[0.3, 0.1], [0.1, 0.2]])
    mean, p = np.array([1.0, -2.0, 0.5, 0.25]), np.diag([1.0, 2.0, 0.5, 0.3])
    rng = np.random.default_rng(7)
    state, readings = rng.multivariate_normal(mean, p), []
    for _ in range(STEPS):
        state = f @ state + rng.multivariate_normal(np.zeros(4), q)
        readings.append(state[:2] + rng.multivariate_normal(np.zeros(2), r))
    return {"mean": mean, "P": p, "F": f, "Q": q, "H": np.eye(2, 4), "R": r, "readings": readings}


def landmarks() -> dict[str, Any]:
    """Return the first steps of the benchmark's problem, whose headings do not come near pi."""
    problem = LandmarkProblem().as_request()
    readings = np.concatenate((problem["ranges"], problem["bearings"]), axis=1)[:STEPS]
    return {**problem, "mean": problem["start"], "P": np.diag(np.square(problem["start_sigma"])), "readings": readings}


def weighted() -> dict[str, Any]:
    """Return weights of few bits, whose sums are exact in either precision, one of them zero."""
    rng = np.random.default_rng(3)
    counts = rng.multinomial(2**12, rng.dirichlet(np.full(256, 0.5)))
    return {"weights": counts / 2**12, "uniforms": rng.random(256)}


@pytest.fixture(scope="module")
def theirs() -> dict[str, Any]:
    """What the libraries answer, all asked at once."""
    questions = {
        "kalman_filterpy": linear(),
        "kalman_stonesoup": linear(),
        "bootstrap_particles": {**linear(), "n": N, "seed": 1},
        "resampling_particles": weighted(),
        "extended_filterpy": landmarks(),
        "unscented_filterpy": {**landmarks(), **UNSCENTED},
    }
    command = [str(PEERS_PYTHON), "-I", "-W", "ignore", str(Path(__file__).with_name("peer_side.py"))]
    asked = json.dumps(questions, default=lambda array: array.tolist())
    done = subprocess.run(command, input=asked, stdout=subprocess.PIPE, text=True, check=True)
    answers: dict[str, Any] = json.loads(done.stdout)
    return answers


def assert_same_beliefs(ours: list[Gaussian], theirs: list[Any]) -> None:
    assert len(ours) == len(theirs) == STEPS
    for our, (mean, covariance) in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(our.mean, mean, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(our.covariance, covariance, rtol=0.0, atol=1e-8)


def kalman_beliefs(problem: dict[str, Any]) -> list[Gaussian]:
    belief, beliefs = Gaussian(problem["mean"], problem["P"]), []
    for reading in problem["readings"]:
        predicted = kalman.predict(belief, problem["F"], problem["Q"])
        belief = kalman.update(predicted, reading, problem["H"], problem["R"])
        beliefs.append(belief)
    return beliefs


@pytest.mark.parametrize("library", ["filterpy", "stonesoup"])
def test_the_kalman_filter_is_that_of(library: str, theirs: dict[str, Any]) -> None:
    assert_same_beliefs(kalman_beliefs(linear()), theirs[f"kalman_{library}"])


def test_another_noise_would_be_told_apart(theirs: dict[str, Any]) -> None:
    problem = linear()
    problem["Q"] = problem["Q"] * 1.0001
    with pytest.raises(AssertionError):
        assert_same_beliefs(kalman_beliefs(problem), theirs["kalman_filterpy"])


def landmark_models(problem: dict[str, Any]) -> tuple[OdometryMotion, dict[type, RangeBearing]]:
    known = LandmarkMap((i, x, y) for i, (x, y) in enumerate(problem["landmarks"]))
    params = RangeBearingParams(
        sigma_range=SIGMA_RANGE_M,
        sigma_range_per_m=0.0,
        sigma_bearing=SIGMA_BEARING,
        gate=None,
        outlier_fraction=0.0,
        tempering=1.0,
    )
    motion = OdometryMotion(OdometryParams(alpha_1=ALPHA, alpha_2=ALPHA, alpha_3=ALPHA, alpha_4=ALPHA))
    return motion, {RangeBearingReadings: RangeBearing(params, known)}


def landmark_beliefs(filter_: Any, problem: dict[str, Any]) -> list[Gaussian]:
    control, ids = LandmarkProblem().control, np.arange(len(problem["landmarks"]))
    belief, beliefs = Gaussian(np.array(problem["mean"]), problem["P"]), []
    for reading in problem["readings"]:
        seen = RangeBearingReadings(ids, *np.split(reading, 2))
        belief, innovation = filter_.update(filter_.predict(belief, control), seen)
        assert innovation.used
        beliefs.append(belief)
    return beliefs


def test_the_extended_kalman_filter_is_that_of_filterpy(theirs: dict[str, Any]) -> None:
    problem = landmarks()
    extended: ExtendedKalman[Any] = ExtendedKalman(*landmark_models(problem))
    assert_same_beliefs(landmark_beliefs(extended, problem), theirs["extended_filterpy"])


def test_the_unscented_kalman_filter_is_that_of_filterpy(theirs: dict[str, Any]) -> None:
    problem = landmarks()
    params = UnscentedKalmanParams(alpha=UNSCENTED["alpha"], beta=UNSCENTED["beta"], kappa=UNSCENTED["kappa"])
    unscented: UnscentedKalman[Any] = UnscentedKalman(*landmark_models(problem), params)
    assert_same_beliefs(landmark_beliefs(unscented, problem), theirs["unscented_filterpy"])


def test_systematic_resampling_and_n_eff_are_those_of_particles(theirs: dict[str, Any]) -> None:
    problem, answer = weighted(), theirs["resampling_particles"]
    weights = problem["weights"].astype(np.float32)
    chosen = systematic(weights, problem["uniforms"][0])
    np.testing.assert_array_equal(chosen, answer["systematic"])
    assert len(set(chosen.tolist())) < len(chosen)
    assert effective_sample_size(weights) == pytest.approx(answer["n_eff"], rel=1e-6)


def test_stratified_resampling_is_that_of_particles(theirs: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    problem = weighted()
    monkeypatch.setattr(Stream, "fine_uniforms", lambda _self, count: problem["uniforms"][:count])
    chosen = Stratified().select(problem["weights"].astype(np.float32), 256, Stream.of(0, "test", 0))
    np.testing.assert_array_equal(chosen, theirs["resampling_particles"]["stratified"])


def error_in_draws(means: Any, exact: list[Gaussian]) -> float:
    """Return the errors' root mean square, in units of that of a mean of N independent draws."""
    off = [
        (mean - belief.mean) / np.sqrt(np.diag(belief.covariance)) for mean, belief in zip(means, exact, strict=True)
    ]
    return float(np.sqrt(N * np.mean(np.square(off))))


def test_particle_filters_tend_to_the_kalman_filter_ours_and_that_of_particles(theirs: dict[str, Any]) -> None:
    problem = linear()
    exact, ours = kalman_beliefs(problem), our_means(problem)
    # Unequal weights and resampling cost both the same: 4 in the mean of many seeds.
    assert error_in_draws(ours, exact) < 6.0
    assert error_in_draws(theirs["bootstrap_particles"], exact) < 6.0
    # and that is less than what twice the noise would make.
    wrong = kalman_beliefs({**problem, "R": 2.0 * problem["R"]})
    assert error_in_draws(ours, wrong) > 12.0


def our_means(problem: dict[str, Any]) -> list[Any]:
    rows = {name: tuple(map(tuple, problem[name].tolist())) for name in ("F", "Q")}
    motion = LinearGaussian(LinearGaussianParams(transition=rows["F"], noise=rows["Q"]))
    measurement = LinearMeasurement(problem["H"], problem["R"])
    pf = ParticleFilter(motion, {Observation: measurement}, estimate=lambda particles, weights: particles @ weights)
    drawn = np.random.default_rng(5).multivariate_normal(problem["mean"], problem["P"], N).T
    cloud, means = pf.start(np.ascontiguousarray(drawn), Stream.of(0, "test", 0, "start")), []
    for step, reading in enumerate(problem["readings"]):
        cloud, report = pf.update(cloud, np.empty(0), [Observation(reading)], Stream.of(0, "test", step))
        means.append(report.estimate)
    return means
