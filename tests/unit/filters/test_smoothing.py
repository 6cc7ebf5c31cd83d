"""Smoothers against the posterior of a whole trajectory at once, and particles against the Kalman smoother."""

import numpy as np
import pytest

from dynpf.filters import kalman
from dynpf.filters.extended import ExtendedKalman
from dynpf.filters.kalman import Gaussian
from dynpf.filters.smoothing import Generation, extended_rts, fixed_lag, rts
from dynpf.se2 import wrap_angle
from tests.unit.filters.gaussian_models import Linear, SeenLandmarks, Sightings, Unicycle, drive

STEPS = 12
F = np.array([[1.0, 0.5], [0.0, 1.0]])
Q = np.array([[0.05, 0.02], [0.02, 0.1]])
H = np.array([[1.0, 0.0]])
R = np.array([[0.3]])
PRIOR = Gaussian(np.array([1.0, -0.5]), np.array([[2.0, 0.3], [0.3, 1.0]]))


def filtered(readings, process=Q):
    """Return the beliefs after each reading, the first being about the prior, and the predictions between."""
    beliefs, predicted = [kalman.update(PRIOR, readings[0], H, R)], []
    for reading in readings[1:]:
        predicted.append(kalman.predict(beliefs[-1], F, process))
        beliefs.append(kalman.update(predicted[-1], reading, H, R))
    return beliefs, predicted


def whole_trajectory(readings):
    """Return means (T, 2) and covariances (T, 2, 2) of the joint posterior of all states, by its information."""
    size = 2 * len(readings)
    information, vector = np.zeros((size, size)), np.zeros(size)
    information[:2, :2] = np.linalg.inv(PRIOR.covariance)
    vector[:2] = information[:2, :2] @ PRIOR.mean
    for step, reading in enumerate(readings):
        now = slice(2 * step, 2 * step + 2)
        information[now, now] += H.T @ H / R[0, 0]
        vector[now] += H[0] * reading[0] / R[0, 0]
        if step:
            link = np.zeros((2, size))
            link[:, 2 * step - 2 : 2 * step], link[:, now] = -F, np.eye(2)
            information += link.T @ np.linalg.solve(Q, link)
    covariance = np.linalg.inv(information)
    blocks = [covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(readings))]
    return (covariance @ vector).reshape(-1, 2), np.array(blocks)


def readings_of(seed):
    return list(np.random.default_rng(seed).standard_normal((STEPS, 1)) * 2.0)


def test_rts_is_the_posterior_of_the_whole_trajectory():
    readings = readings_of(1)
    beliefs, predicted = filtered(readings)
    smoothed = rts(beliefs, predicted, [F] * (STEPS - 1))
    means, covariances = whole_trajectory(readings)
    np.testing.assert_allclose([belief.mean for belief in smoothed], means, atol=1e-12)
    np.testing.assert_allclose([belief.covariance for belief in smoothed], covariances, atol=1e-12)
    assert not np.allclose([belief.mean for belief in beliefs], means, atol=0.1)  # control: filtering is not enough
    again = extended_rts(Linear(F, Q), beliefs, [np.zeros(2)] * (STEPS - 1), angles=())
    np.testing.assert_allclose([belief.mean for belief in again], means, atol=1e-12)


def test_rts_of_a_motion_without_noise_is_one_trajectory():
    """Nothing moves the state but F, so what is known in the end is known of the beginning; singular or not."""
    beliefs, predicted = filtered(readings_of(2), process=np.zeros((2, 2)))
    smoothed = rts(beliefs, predicted, [F] * (STEPS - 1))
    carried = np.linalg.matrix_power(F, STEPS - 1) @ smoothed[0].mean
    np.testing.assert_allclose(carried, beliefs[-1].mean, atol=1e-9)
    sure = [Gaussian(belief.mean, np.diag([1.0, 0.0])) for belief in beliefs]
    covariances = [belief.covariance for belief in rts(sure, sure[1:], [np.eye(2)] * (STEPS - 1))]
    np.testing.assert_allclose(covariances, np.broadcast_to(np.diag([1.0, 0.0]), (STEPS, 2, 2)), atol=1e-12)


def test_rts_refuses_lists_that_do_not_fit():
    beliefs, predicted = filtered(readings_of(3))
    with pytest.raises(ValueError, match="12 filtered beliefs"):
        rts(beliefs, predicted, [F] * STEPS)
    with pytest.raises(ValueError, match="12 filtered beliefs"):
        extended_rts(Linear(F, Q), beliefs, [np.zeros(2)] * STEPS, angles=())


def test_the_extended_smoother_is_nearer_to_the_truth_than_the_filter():
    def squared(beliefs, poses):
        error = np.array([belief.mean for belief in beliefs]) - poses[1:]
        error[:, 2] = wrap_angle(error[:, 2])
        return (error[:-1] ** 2).mean(axis=0)

    before, after = np.zeros(3), np.zeros(3)
    for seed in range(8):
        poses, controls, sightings = drive(np.random.default_rng(seed))
        extended = ExtendedKalman(Unicycle(), {Sightings: SeenLandmarks()})
        belief, beliefs = Gaussian(poses[0], np.diag([0.1, 0.1, 0.05])), []
        for control, sighting in zip(controls, sightings, strict=True):
            belief, _ = extended.update(extended.predict(belief, control), sighting)
            beliefs.append(belief)
        smoothed = extended_rts(Unicycle(), beliefs, controls[1:])
        before += squared(beliefs, poses)
        after += squared(smoothed, poses)
        assert np.abs(poses[:, 2]).max() > 3.0  # control: the heading crosses the cut
    assert (after < 0.8 * before).all()


def particle_filter(readings, count, seed):
    """Return the generations of a bootstrap filter that resamples, multinomially, at every other step."""
    rng = np.random.default_rng(seed)
    particles = PRIOR.mean[:, None] + np.linalg.cholesky(PRIOR.covariance) @ rng.standard_normal((2, count))
    weights, generations = np.full(count, 1.0 / count), []
    for step, reading in enumerate(readings):
        ancestors = None
        if step:
            if step % 2 == 0:
                ancestors = rng.choice(count, count, p=weights)
                particles, weights = particles[:, ancestors], np.full(count, 1.0 / count)
            particles = F @ particles + np.linalg.cholesky(Q) @ rng.standard_normal((2, count))
        weights = weights * np.exp(-0.5 * (reading[0] - particles[0]) ** 2 / R[0, 0])
        weights = weights / weights.sum()
        generations.append(Generation(particles.astype(np.float32), weights.astype(np.float32), ancestors))
    return generations


def test_particles_of_the_past_agree_with_the_posterior_of_the_whole_trajectory():
    readings = [np.array([0.8 - 0.2 * step]) for step in range(STEPS)]
    generations = particle_filter(readings, 40_000, 5)
    smoothed = list(fixed_lag(generations, STEPS, angles=()))
    means, covariances = whole_trajectory(readings)
    assert len(smoothed) == STEPS
    np.testing.assert_allclose([one.mean for one in smoothed], means, atol=0.03)
    np.testing.assert_allclose([one.covariance for one in smoothed], covariances, atol=0.03)
    now = np.array([one.mean for one in fixed_lag(generations, 0, angles=())])
    np.testing.assert_allclose(now, [belief.mean for belief in filtered(readings)[0]], atol=0.03)
    assert np.abs(now - means).max() > 0.1  # control: lag 0 is the filter, which is something else


def test_lineage_is_followed_and_ancestors_are_counted():
    """Three generations: the last two particles descend from particle 2 alone."""
    first = Generation(np.array([[0.0, 1.0, 2.0]]), np.full(3, 1 / 3), None)
    second = Generation(np.array([[10.0, 11.0, 12.0]]), np.full(3, 1 / 3), np.array([1, 2, 2]))
    third = Generation(np.array([[20.0, 21.0]]), np.array([0.25, 0.75]), np.array([1, 2]))
    fourth = Generation(np.array([[30.0, 31.0]]), np.array([0.5, 0.5]), None)
    generations = [first, second, third, fourth]
    found = [(one.mean[0], one.distinct) for one in fixed_lag(generations, 2, angles=())]
    assert found == [(2.0, 1), (11.5, 2), (20.5, 2), (30.5, 2)]
    one_step = next(fixed_lag(iter(generations), 1, angles=()))
    assert one_step.mean[0] == pytest.approx((1.0 + 2.0 + 2.0) / 3)
    assert one_step.distinct == 2
    with pytest.raises(ValueError, match="lag = -1"):
        next(fixed_lag(generations, -1))


def test_smoothed_headings_are_averaged_on_the_circle():
    poses = np.array([[0.0, 2.0], [1.0, 1.0], [np.pi - 0.1, -np.pi + 0.3]])
    smoothed = next(fixed_lag([Generation(poses, np.array([0.5, 0.5]), None)], 3))
    np.testing.assert_allclose(smoothed.mean, [1.0, 1.0, -np.pi + 0.1])
    np.testing.assert_allclose(smoothed.covariance, [[1.0, 0.0, 0.2], [0.0, 0.0, 0.0], [0.2, 0.0, 0.04]], atol=1e-12)
