"""Wheel encoders, optionally with a rate gyro: twists of a simulated robot or a log, or poses of a log."""

import math

import msgspec
import numpy as np
from dynpf_protocol.messages import Odometry, OdometryPose, RobotState
from dynpf_runtime.node import State
from dynpf_services.scenario.context import Context
from dynpf_services.sensors.kind import Read, SensorKind, SensorTable, Simulated, Truth, passed

from dynpf.filters.kalman import Gaussian
from dynpf.motion.gyro import GyroOdometry, GyroOdometryParams
from dynpf.portable import hypot
from dynpf.rng import Draws
from dynpf.types import NonNegative, Positive

__all__ = ["ODOMETRY", "ODOMETRY_POSE", "GyroSensor", "OdometrySensor"]


class GyroSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A rate gyro, and the extended Kalman filter that corrects the wheels' turning rate by it."""

    w_std: NonNegative = 0.005  # rad/s
    w_bias: float = 0.0  # rad/s
    filter: GyroOdometryParams = GyroOdometryParams()


class OdometrySensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Wheel encoders: Gaussian noise of standard deviation sqrt(std^2 + (std_per_unit * true)^2), and a bias."""

    v_std: NonNegative = 0.0  # m/s
    v_std_per_unit: NonNegative = 0.0  # of the true speed
    v_bias: float = 0.0  # m/s
    w_std: NonNegative = 0.0  # rad/s
    w_std_per_unit: NonNegative = 0.0  # of the true turning rate
    w_bias: float = 0.0  # rad/s
    w_scale: Positive = (
        1.0  # of the true turning rate: wheels farther apart or closer together than they are taken to be
    )
    gyro: GyroSensor | None = None  # absent: the wheels alone


def _made(sensor: OdometrySensor, context: Context) -> Read:
    if sensor.gyro is not None:
        return _Corrected(sensor, sensor.gyro, context.tick_s * sensor.every)
    return lambda truth, draws: _wheels(sensor, truth.robot, draws)


def _wheels(sensor: OdometrySensor, robot: RobotState, draws: Draws) -> Odometry:
    noise_v, noise_w = draws.standard_normal(2).tolist()
    return Odometry(
        v=robot.v + sensor.v_bias + hypot(sensor.v_std, sensor.v_std_per_unit * robot.v) * noise_v,
        w=sensor.w_scale * robot.w + sensor.w_bias + hypot(sensor.w_std, sensor.w_std_per_unit * robot.w) * noise_w,
    )


class _Corrected:
    """Odometry of the wheels with its turning rate corrected by the gyro."""

    def __init__(self, wheels: OdometrySensor, gyro: GyroSensor, period_s: float) -> None:
        self._wheels, self._gyro, self._period_s = wheels, gyro, period_s
        self._filter = GyroOdometry(gyro.filter)
        self._turning: Gaussian = self._filter.start()

    def __call__(self, truth: Truth, draws: Draws) -> Odometry:
        reading = _wheels(self._wheels, truth.robot, draws)
        rate = truth.robot.w + self._gyro.w_bias + self._gyro.w_std * float(draws.standard_normal())
        self._turning = self._filter.update(self._turning, reading.w, rate, self._period_s)
        return Odometry(v=reading.v, w=float(self._turning.mean[0]))

    def freeze(self) -> State:
        """Return the gyro filter's belief of the turning rate."""
        return {"turning": self._turning._asdict()}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._turning = Gaussian(**{name: np.array(value) for name, value in state["turning"].items()})


ODOMETRY = SensorKind(
    name="odometry",
    message=Odometry,
    simulated=Simulated(OdometrySensor, _made),
    checked=passed(lambda reading: math.isfinite(reading.v) and math.isfinite(reading.w)),
)

ODOMETRY_POSE = SensorKind(
    name="odometry_pose",
    message=OdometryPose,
    checked=passed(lambda reading: all(map(math.isfinite, (reading.x, reading.y, reading.theta)))),
)
