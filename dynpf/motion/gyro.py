"""Wheel odometry improved by a gyro: an extended Kalman filter over the turning rate and both sensors' errors.

TURTLEBOT has robot_pose_ekf do this. Wheels turn a heading wrong by a factor, for their distance is never quite what it
is taken to be; a gyro is off by a bias. Each shows the other's error: on a straight way the bias, in a turn the factor.
"""

import msgspec
import numpy as np

from dynpf.filters.kalman import Gaussian, corrected
from dynpf.params import validated
from dynpf.portable import product
from dynpf.types import NonNegative, Positive

__all__ = ["GyroOdometry", "GyroOdometryParams"]


class GyroOdometryParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Standard deviations: of the readings, of what is not known at first, and of how it drifts in a second."""

    wheel_sigma: Positive = 0.02  # rad/s
    gyro_sigma: Positive = 0.005  # rad/s
    turn_change: Positive = 2.0  # rad/s by which the turning rate may change from one reading to the next
    scale_sigma: Positive = 0.1  # of the wheels' factor, about 1
    bias_sigma: Positive = 0.05  # rad/s, of the gyro's bias, about 0
    scale_drift: NonNegative = 0.0  # per square root of a second
    bias_drift: NonNegative = 1e-4  # rad/s per square root of a second


class GyroOdometry:
    """The belief is of turning rate w (rad/s), the wheels' factor s and the gyro's bias b (rad/s), in this order.

    Wheels read s w plus noise and the gyro w + b plus noise. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: GyroOdometryParams) -> None:
        self.params = validated(params)

    def start(self) -> Gaussian:
        """Return the belief before any reading."""
        p = self.params
        return Gaussian(np.array([0.0, 1.0, 0.0]), np.square(np.diag([p.turn_change, p.scale_sigma, p.bias_sigma])))

    def update(self, belief: Gaussian, wheels: float, gyro: float, duration: float) -> Gaussian:
        """Return the belief after both readings (rad/s), ``duration`` seconds after the last ones."""
        p = self.params
        drift = np.square(np.array([p.turn_change, p.scale_drift, p.bias_drift])) * np.array([1.0, duration, duration])
        covariance = belief.covariance + np.diag(drift)
        # The gyro tells nearly what the rate is: about that the product of rate and factor is made linear.
        _, scale, bias = belief.mean
        rate = gyro - bias
        observation = np.array([[scale, rate, 0.0], [1.0, 0.0, 1.0]])
        noise = np.square(np.diag([p.wheel_sigma, p.gyro_sigma]))
        prior = np.array([rate, scale, bias])
        expected = np.array([scale * rate, rate + bias])
        # Linearized at a point other than the mean: h(prior) + H (mean - prior).
        innovation = np.array([wheels, gyro]) - expected - product(observation, belief.mean - prior)
        return corrected(Gaussian(belief.mean, covariance), innovation, observation, noise)
