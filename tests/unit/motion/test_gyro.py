"""Gyro-aided odometry: it finds the wheels' factor and the gyro's bias, and then turns are right."""

import numpy as np
import pytest

from dynpf.motion.gyro import GyroOdometry, GyroOdometryParams

SCALE, BIAS = 1.05, 0.02


def drive(turning: np.ndarray, params: GyroOdometryParams, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return the means (T, 3), and the last covariance."""
    rng = np.random.default_rng(seed)
    odometry = GyroOdometry(params)
    belief, means = odometry.start(), []
    for rate in turning:
        wheels = SCALE * rate + 0.01 * rng.standard_normal()
        gyro = rate + BIAS + 0.005 * rng.standard_normal()
        belief = odometry.update(belief, wheels, gyro, 0.1)
        means.append(belief.mean)
    return np.array(means), belief.covariance


PARAMS = GyroOdometryParams(wheel_sigma=0.01, gyro_sigma=0.005)
TURNING = np.where(np.arange(600) % 200 < 120, 0.0, 0.6)


def test_factor_and_bias_are_found_within_what_the_filter_claims() -> None:
    errors, claimed = [], []
    for seed in range(12):
        means, covariance = drive(TURNING, PARAMS, seed)
        errors.append(means[-1, 1:] - [SCALE, BIAS])
        claimed.append(np.diag(covariance)[1:])
    ratio = np.mean(np.square(errors), axis=0) / np.mean(claimed, axis=0)
    assert (ratio < 2.5).all()  # 12 draws of a chi-square with one degree of freedom: above in one of 500
    assert np.abs(np.mean(errors, axis=0)).max() < 0.005


def test_the_heading_drifts_less_than_with_either_sensor_alone() -> None:
    means, _ = drive(TURNING, PARAMS)
    true = np.sum(TURNING) * 0.1
    fused = np.sum(means[:, 0]) * 0.1
    assert abs(fused - true) < 0.1
    assert abs(SCALE * true - true) > 0.5
    assert 600 * 0.1 * BIAS > 1.0


def test_on_a_straight_way_the_factor_stays_unknown() -> None:
    means, covariance = drive(np.zeros(300), PARAMS)
    assert means[-1, 2] == pytest.approx(BIAS, abs=0.003)
    assert np.sqrt(covariance[1, 1]) > 0.05


def test_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="gyro_sigma"):
        GyroOdometry(GyroOdometryParams(gyro_sigma=0.0))
