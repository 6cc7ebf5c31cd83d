"""The extended and the unscented Kalman filter: the same claims of both, then each one's own."""

import numpy as np
import pytest

from dynpf.filters.extended import ExtendedKalman, ExtendedKalmanParams
from dynpf.filters.kalman import Gaussian
from dynpf.filters.unscented import UnscentedKalman, UnscentedKalmanParams
from dynpf.metrics.consistency import Verdict, mean_square, nees
from dynpf.se2 import wrap_angle
from tests.unit.filters.gaussian_models import (
    LANDMARKS,
    Linear,
    LinearReading,
    Numbers,
    SeenLandmarks,
    Sightings,
    Unicycle,
    drive,
)

PERIOD = 0.5
TRANSITION = np.kron(np.array([[1.0, PERIOD], [0.0, 1.0]]), np.eye(2))  # state: x, y, vx, vy
PROCESS = np.kron(np.array([[PERIOD**3 / 3, PERIOD**2 / 2], [PERIOD**2 / 2, PERIOD]]), 0.2 * np.eye(2))
OBSERVATION = np.eye(2, 4)
NOISE = np.array([[0.3, 0.1], [0.1, 0.2]])


def extended(motion, measurements, angles=(2,), iterations=1):
    return ExtendedKalman(motion, measurements, ExtendedKalmanParams(angles=angles, iterations=iterations))


def unscented(motion, measurements, angles=(2,), alpha=1.0, kappa=0.0):
    return UnscentedKalman(motion, measurements, UnscentedKalmanParams(angles=angles, alpha=alpha, kappa=kappa))


def narrow(motion, measurements, angles=(2,)):
    """The points very near to the mean, with weights of -1e6 and more in the textbook's form."""
    return unscented(motion, measurements, angles, alpha=1e-3)


both = pytest.mark.parametrize("kind", [extended, unscented])
start = Gaussian(np.array([1.5, -1.5, 3.0]), np.diag([0.04, 0.04, 0.01]))


def run(kalman, belief, controls, readings, gate=None):
    """Return the beliefs after each step, and the innovations."""
    beliefs, innovations = [], []
    for control, reading in zip(controls, readings, strict=True):
        belief, innovation = kalman.update(kalman.predict(belief, control), reading, gate)
        beliefs.append(belief)
        innovations.append(innovation)
    return beliefs, innovations


@pytest.mark.parametrize("kind", [extended, unscented, narrow])
def test_a_linear_system_gets_the_textbook_filter(kind):
    """Constant velocity in the plane, position seen: means, covariances, innovations of the plain equations."""
    rng = np.random.default_rng(1)
    readings = [Numbers(rng.standard_normal(2) * 3.0) for _ in range(40)]
    controls = [rng.standard_normal(4) for _ in readings]
    kalman = kind(Linear(TRANSITION, PROCESS), {Numbers: LinearReading(OBSERVATION, NOISE)}, angles=())
    beliefs, innovations = run(kalman, Gaussian(np.zeros(4), 10.0 * np.eye(4)), controls, readings)

    x, p = np.zeros(4), 10.0 * np.eye(4)
    for control, reading, belief, innovation in zip(controls, readings, beliefs, innovations, strict=True):
        x, p = TRANSITION @ x + control, TRANSITION @ p @ TRANSITION.T + PROCESS
        y, s = reading.values - OBSERVATION @ x, OBSERVATION @ p @ OBSERVATION.T + NOISE
        k = p @ OBSERVATION.T @ np.linalg.inv(s)
        x, p = x + k @ y, p - k @ s @ k.T
        np.testing.assert_allclose(belief.mean, x, rtol=0, atol=1e-8)
        np.testing.assert_allclose(belief.covariance, p, rtol=0, atol=1e-8)
        np.testing.assert_allclose(innovation.vector, y, rtol=0, atol=1e-8)
        np.testing.assert_allclose(innovation.covariance, s, rtol=0, atol=1e-8)
        assert innovation.nis == pytest.approx(y @ np.linalg.inv(s) @ y)
        assert innovation.used


@both
def test_a_robot_among_landmarks_is_followed_consistently(kind):
    """Over independent runs, NEES at the last step and NIS at every one lie in their bands."""
    squares, surprises = [], []
    for seed in range(40):
        poses, controls, sightings = drive(np.random.default_rng(seed), steps=25)
        began = poses[0] + np.sqrt(np.diag(start.covariance)) * np.random.default_rng(100 + seed).standard_normal(3)
        kalman = kind(Unicycle(), {Sightings: SeenLandmarks()})
        beliefs, innovations = run(kalman, start._replace(mean=began), controls, sightings)
        error = beliefs[-1].mean - poses[-1]
        error[2] = wrap_angle(error[2])
        squares.append(nees(error[:, None], beliefs[-1].covariance[None])[0])
        surprises += [innovation.nis for innovation in innovations]
    assert mean_square(np.array(squares), 3, 0.999).verdict is Verdict.CONSISTENT
    assert mean_square(np.array(surprises), 2, 0.999).verdict is Verdict.CONSISTENT


@both
def test_headings_meet_across_the_cut(kind):
    """A compass that reads just beyond pi, a belief just below: the update goes the short way."""

    class Compass(LinearReading):
        def innovation(self, states, reading):
            return wrap_angle(super().innovation(states, reading))

        def angular(self, _reading):
            return np.array([True])

    kalman = kind(Unicycle(), {Numbers: Compass(np.array([[0.0, 0.0, 1.0]]), np.array([[0.01]]))})
    belief = Gaussian(np.array([0.0, 0.0, np.pi - 0.05]), np.diag([0.1, 0.1, 0.01]))
    updated, _ = kalman.update(belief, Numbers(np.array([-np.pi + 0.15])))
    assert updated.mean[2] == pytest.approx(-np.pi + 0.05, abs=1e-9)
    assert updated.covariance[2, 2] == pytest.approx(0.005)
    predicted = kalman.predict(belief, (0.0, 0.1))
    assert predicted.mean[2] == pytest.approx(-np.pi + 0.05, abs=1e-9)
    assert predicted.covariance[2, 2] == pytest.approx(0.011)


@both
def test_a_reading_beyond_the_gate_is_refused(kind):
    kalman = kind(Unicycle(), {Sightings: SeenLandmarks()})
    good = SeenLandmarks(1e-9, 1e-9).see(start.mean, LANDMARKS, np.random.default_rng(0))
    bad = good._replace(ranges=good.ranges + 2.0)
    _, innovation = kalman.update(start, bad)
    assert innovation.used
    assert innovation.nis > 50.0
    refused, same = kalman.update(start, bad, gate=innovation.nis - 1e-6)
    assert refused is start
    assert not same.used
    assert same.nis == innovation.nis
    assert kalman.update(start, bad, gate=innovation.nis)[1].used


@both
def test_what_is_not_a_number_is_refused(kind):
    landmarks = kind(Unicycle(), {Sightings: SeenLandmarks()})
    partly = SeenLandmarks().see(start.mean, LANDMARKS, np.random.default_rng(0))
    partly.ranges[1] = np.nan
    belief, innovation = landmarks.update(start, partly)
    assert innovation.vector.shape == (4,)  # the model left the broken sighting out
    assert np.isfinite(belief.mean).all()
    belief, innovation = landmarks.update(start, partly._replace(ranges=np.full(3, np.nan)))
    assert belief is start
    assert not innovation.used
    unchecked = kind(Unicycle(), {Numbers: LinearReading(np.eye(3), np.eye(3))})
    for broken in (np.nan, np.inf):
        belief, innovation = unchecked.update(start, Numbers(np.array([0.0, broken, 0.0])))
        assert belief is start
        assert not innovation.used
        assert np.isnan(innovation.nis)


@both
def test_a_model_sees_how_unsure_the_belief_is(kind):
    """Its gate is shown states of the belief's mean and covariance."""
    shown = []

    class Watching(LinearReading):
        def admit(self, particles, weights, _reading):
            shown.append((particles, weights))

    belief = Gaussian(np.array([1.0, 2.0, 0.3]), np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.0], [0.1, 0.0, 0.2]]))
    updated, innovation = kind(Unicycle(), {Numbers: Watching(np.eye(3), np.eye(3))}).update(
        belief, Numbers(np.ones(3))
    )
    ((states, weights),) = shown
    np.testing.assert_allclose(states @ weights, belief.mean)
    np.testing.assert_allclose(np.cov(states, aweights=weights, ddof=0), belief.covariance, atol=1e-12)
    assert updated is belief
    assert innovation.vector.size == 0


@both
def test_a_control_that_is_not_a_number_is_an_error(kind):
    with pytest.raises(ValueError, match="not finite"):
        kind(Unicycle(), {}).predict(start, (np.nan, 0.0))


@both
def test_nothing_unknown_and_nothing_moved_stays_so(kind):
    """A singular covariance goes through: a pose known for sure, then one of which only the heading is unsure."""
    kalman = kind(Unicycle((0.0, 0.0, 0.0)), {Sightings: SeenLandmarks()})
    sure = Gaussian(start.mean, np.zeros((3, 3)))
    sighting = SeenLandmarks().see(start.mean, LANDMARKS, np.random.default_rng(3))
    updated, _ = kalman.update(kalman.predict(sure, (0.0, 0.0)), sighting)
    np.testing.assert_allclose(updated.mean, sure.mean, atol=1e-15)
    np.testing.assert_array_equal(updated.covariance, 0.0)
    turned, innovation = kalman.update(sure._replace(covariance=np.diag([0.0, 0.0, 0.2])), sighting)
    assert innovation.used
    np.testing.assert_allclose(turned.mean[:2], start.mean[:2])
    assert 0.0 < turned.covariance[2, 2] < 0.01


@both
def test_covariances_stay_symmetric_and_positive_over_a_long_run_of_sharp_readings(kind):
    sharp = SeenLandmarks(1e-5, 1e-6)
    _, controls, sightings = drive(np.random.default_rng(7), steps=400, process=(1e-4, 1e-9, 1e-6), model=sharp)
    kalman = kind(Unicycle((1e-4, 1e-9, 1e-6)), {Sightings: sharp})
    beliefs, _ = run(kalman, start, controls, sightings)
    for belief in beliefs:
        assert (belief.covariance == belief.covariance.T).all()
        assert np.linalg.eigvalsh(belief.covariance)[0] > 0.0


def test_models_in_float32_do_not_take_the_belief_with_them():
    class Rounded(Linear):
        def expected(self, states, control):
            assert states.dtype == np.float64
            return super().expected(states, control).astype(np.float32)

    for kind in (extended, unscented):
        predicted = kind(Rounded(np.eye(3), 0.1 * np.eye(3)), {}).predict(start, np.zeros(3))
        assert predicted.mean.dtype == predicted.covariance.dtype == np.float64


def test_iterations_find_the_most_probable_state():
    """From a poor prior and a sharp sighting, Gauss-Newton ends where the gradient of the posterior vanishes."""
    model = SeenLandmarks(0.01, 0.01)
    prior = Gaussian(np.array([0.5, 0.5, 0.4]), np.diag([1.0, 1.0, 0.3]))
    sighting = model.see(np.array([-0.3, 1.0, 0.1]), LANDMARKS[:1], np.random.default_rng(2))

    def slope(mean):
        observation = model.jacobian(mean[:, None], sighting)[..., 0]
        misfit = np.linalg.solve(model.noise(sighting), model.innovation(mean[:, None], sighting)[:, 0])
        return np.linalg.norm(observation.T @ misfit - np.linalg.solve(prior.covariance, mean - prior.mean))

    once, _ = extended(Unicycle(), {Sightings: model}).update(prior, sighting)
    often, innovation = extended(Unicycle(), {Sightings: model}, iterations=20).update(prior, sighting)
    assert slope(often.mean) < 1e-6
    assert slope(once.mean) > 1.0
    # The innovation is that of the prior, whatever the iterations did.
    np.testing.assert_allclose(innovation.vector, model.innovation(prior.mean[:, None], sighting)[:, 0])


def test_standing_on_a_landmark_refuses_the_reading_rather_than_the_filter():
    here = Sightings(start.mean[None, :2], np.array([0.1]), np.array([0.0]))
    with np.errstate(all="ignore"):
        belief, innovation = extended(Unicycle(), {Sightings: SeenLandmarks()}).update(start, here)
    assert belief is start
    assert not innovation.used


def test_points_give_the_textbook_sums():
    """Prediction and update with the scaled weights in their usual form, of models that are far from linear."""
    alpha, beta, kappa = 0.5, 2.0, 1.0
    belief = Gaussian(np.array([0.2, -0.1, 0.5]), np.array([[0.3, 0.1, 0.05], [0.1, 0.2, 0.02], [0.05, 0.02, 0.4]]))
    motion, model = Unicycle(), SeenLandmarks()
    sighting = model.see(belief.mean, LANDMARKS, np.random.default_rng(5))
    params = UnscentedKalmanParams(alpha=alpha, beta=beta, kappa=kappa)
    unscented = UnscentedKalman(motion, {Sightings: model}, params)

    scale = alpha**2 * (3 + kappa)
    root = np.linalg.cholesky(scale * belief.covariance)
    points = np.concatenate((belief.mean[:, None], belief.mean[:, None] + root, belief.mean[:, None] - root), axis=1)
    for_mean = np.full(7, 0.5 / scale)
    for_mean[0] = (scale - 3) / scale
    for_covariance = for_mean.copy()
    for_covariance[0] += 1 - alpha**2 + beta

    def moments(columns):
        deviations = columns - (columns @ for_mean)[:, None]
        return columns @ for_mean, deviations, (for_covariance * deviations) @ deviations.T

    predicted = unscented.predict(belief, (2.0, 0.3))
    mean, _, covariance = moments(motion.expected(points, (2.0, 0.3)))
    np.testing.assert_allclose(predicted.mean, mean, atol=1e-13)
    np.testing.assert_allclose(predicted.covariance, covariance + motion.process, atol=1e-13)

    updated, innovation = unscented.update(belief, sighting)
    vector, deviations, spread = moments(model.innovation(points, sighting))
    spread += model.noise(sighting)
    gain = -((for_covariance * (points - belief.mean[:, None])) @ deviations.T) @ np.linalg.inv(spread)
    np.testing.assert_allclose(innovation.vector, vector, atol=1e-13)
    np.testing.assert_allclose(innovation.covariance, spread, atol=1e-13)
    np.testing.assert_allclose(updated.mean, belief.mean + gain @ vector, atol=1e-12)
    np.testing.assert_allclose(updated.covariance, belief.covariance - gain @ spread @ gain.T, atol=1e-12)


def test_points_see_the_curvature_that_a_tangent_misses():
    """E{cos(theta)} = exp(-sigma^2 / 2) cos(mean): a robot unsure of its heading gets less far."""
    unsure = Gaussian(np.zeros(3), np.diag([1e-6, 1e-6, 0.3]))
    exact = 5.0 * np.exp(-0.15)
    assert extended(Unicycle(), {}).predict(unsure, (5.0, 0.0)).mean[0] == pytest.approx(5.0)
    assert unscented(Unicycle(), {}).predict(unsure, (5.0, 0.0)).mean[0] == pytest.approx(exact, rel=0.01)


def test_bearings_are_told_apart_across_the_cut_where_the_model_names_its_angles():
    """A landmark in front that is seen behind: its innovation is near pi, on both sides of it for the points."""
    belief = Gaussian(np.zeros(3), np.diag([1e-4, 1e-4, 0.2]))
    behind = Sightings(np.array([[4.0, 0.0]]), np.array([4.0]), np.array([np.pi - 0.01]))
    _, named = unscented(Unicycle(), {Sightings: SeenLandmarks()}).update(belief, behind)
    assert named.covariance[1, 1] == pytest.approx(0.2 + 0.05**2, rel=0.01)
    assert abs(named.vector[1]) == pytest.approx(np.pi - 0.01, rel=0.01)

    class Nameless(SeenLandmarks):
        def angular(self, _reading):  # control: a model that names none
            return np.zeros(2, dtype=bool)

    _, muddled = unscented(Unicycle(), {Sightings: Nameless()}).update(belief, behind)
    assert muddled.covariance[1, 1] > 1.0


def test_weights_that_could_make_a_covariance_indefinite_are_refused():
    with pytest.raises(ValueError, match=r"beta = 0\.5"):
        UnscentedKalman(Unicycle(), {}, UnscentedKalmanParams(alpha=1.0, beta=0.5))
    with pytest.raises(ValueError, match="kappa = -3"):
        UnscentedKalman(Unicycle(), {}, UnscentedKalmanParams(kappa=-3.0)).predict(start, (0.0, 0.0))
    with pytest.raises(ValueError, match="alpha = 0"):
        UnscentedKalman(Unicycle(), {}, UnscentedKalmanParams(alpha=0.0))
