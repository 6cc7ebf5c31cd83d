"""Localization among known landmarks: odometry moves the particles, readings weigh them (LANDMARK)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dynpf.filters.estimate import pose_estimate
from dynpf.filters.resampling import effective_sample_size, systematic
from dynpf.filters.sir import Cloud, Outcome, Sir, SystematicResampling
from dynpf.filters.start import around
from dynpf.maps.landmarks import LandmarkMap
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingReading
from dynpf.motion.arcs import Arcs
from dynpf.motion.calibration import CalibratedArcs
from dynpf.motion.model import MotionModel, Twist
from dynpf.rng import generator
from dynpf.se2 import arc_displacement, compose
from protocol import frames
from protocol.messages import (
    Estimate,
    HostEvent,
    LandmarkReadings,
    Log,
    LogLevel,
    Odometry,
    PoseInFrame,
    PosesInFrame,
    planar_pose,
    timestamp,
)
from services.estimator.config import LocalizationConfig
from services.estimator.gaps import GAPS, gap_warning
from services.estimator.picture import draw_scene, robot_transform
from services.node import Output, Received, Result, State, Step
from services.task import Landmark

__all__ = ["LocalizationEstimator"]

NANOSECONDS = 10**9
SHOWN_PARTICLES = 200
SHOWN_PERIOD_NS = NANOSECONDS // 5
SCENE_PERIOD_NS = NANOSECONDS


class _TimedTwist(NamedTuple):
    """A twist that holds from ``from_ns`` on."""

    from_ns: int
    v: float
    w: float


class LocalizationEstimator:
    """The estimator of a robot among landmarks.

    Inputs are taken in the order given. Each first brings the particles to its own stamp, under the twist that
    holds then; one that comes after the particles have passed its stamp counts as if taken now, save odometry
    that a newer one has overtaken, which is dropped. The start pose is that of the first input's stamp.
    """

    name = "estimator"
    reads = frozenset({"sensors/odometry", "sensors/landmarks", GAPS})
    writes = frozenset(
        {
            "estimator/state",
            "estimator/pose",
            "estimator/dead_reckoning",
            "estimator/particles",
            "estimator/transforms",
            "estimator/scene",
            "log",
        }
    )

    def __init__(self, *, config: LocalizationConfig, seed: int, landmarks: Sequence[Landmark]) -> None:
        self._seed = seed
        self._delay_ns = round(config.odometry_delay * NANOSECONDS)
        self._marks = tuple(landmarks)
        self._landmarks = LandmarkMap((mark.id, mark.x, mark.y) for mark in landmarks)
        self._filter = _compose_filter(config, self._landmarks)
        rng = generator(seed, self.name, 0, "start")
        self._cloud = self._filter.start(around(config.start, config.n, rng), rng)
        self._reckoned = np.array([config.start.x, config.start.y, config.start.theta])
        self._stamp_ns: int | None = None
        self._twist = Twist(0.0, 0.0)
        self._coming: list[_TimedTwist] = []
        self._newest_odometry_ns = -1
        self._shown_ns: int | None = None
        self._scene_ns: int | None = None
        self._readings = {outcome.value: 0 for outcome in Outcome}
        self._unknown: list[int] = []

    def step(self, step: Step) -> Result:
        """Take the inputs in; answer with the estimate at the step's stamp, if there were any."""
        if not step.inputs:
            return Result()
        motion = generator(self._seed, self.name, step.number, "motion")
        choice = generator(self._seed, self.name, step.number, "resampling")
        logs: list[Output] = []
        for received in step.inputs:
            self._advance(received.stamp_ns, motion)
            match received.message:
                case Odometry():
                    self._take_odometry(received, received.message, motion)
                case LandmarkReadings():
                    logs += self._take_readings(received, received.message, choice)
                case HostEvent():
                    logs.append(gap_warning(received.message, step.stamp_ns))
        self._advance(step.stamp_ns, motion)
        return Result((*self._report(), *logs))

    def freeze(self) -> State:
        """Return the particles, the twists in force and to come, dead reckoning, and what was reported."""
        return {
            "particles": self._cloud.particles,
            "log_weights": self._cloud.log_weights,
            "reckoned": self._reckoned,
            "stamp_ns": self._stamp_ns,
            "twist": list(self._twist),
            "coming": [list(twist) for twist in self._coming],
            "newest_odometry_ns": self._newest_odometry_ns,
            "shown_ns": self._shown_ns,
            "scene_ns": self._scene_ns,
            "readings": dict(self._readings),
            "unknown": list(self._unknown),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._cloud = Cloud(np.array(state["particles"]), np.array(state["log_weights"]))
        self._reckoned = np.array(state["reckoned"])
        self._stamp_ns = state["stamp_ns"]
        self._twist = Twist(*state["twist"])
        self._coming = [_TimedTwist(*twist) for twist in state["coming"]]
        self._newest_odometry_ns = state["newest_odometry_ns"]
        self._shown_ns = state["shown_ns"]
        self._scene_ns = state["scene_ns"]
        self._readings = dict(state["readings"])
        self._unknown = list(state["unknown"])

    def _take_odometry(self, received: Received, odometry: Odometry, rng: np.random.Generator) -> None:
        if received.stamp_ns < self._newest_odometry_ns:
            return
        self._newest_odometry_ns = received.stamp_ns
        self._coming.append(_TimedTwist(received.stamp_ns + self._delay_ns, odometry.v, odometry.w))
        self._advance(received.stamp_ns, rng)

    def _take_readings(self, received: Received, message: LandmarkReadings, rng: np.random.Generator) -> list[Output]:
        logs: list[Output] = []
        for reading in message.readings:
            if reading.landmark not in self._landmarks and reading.landmark not in self._unknown:
                self._unknown.append(reading.landmark)
                logs.append(self._unknown_landmark(received, reading.landmark))
            self._cloud, outcome = self._filter.reweight(
                self._cloud, RangeBearingReading(reading.landmark, reading.range, reading.bearing)
            )
            self._readings[outcome.value] += 1
        self._cloud = self._filter.resample(self._cloud, rng)
        return logs

    def _advance(self, stamp_ns: int, rng: np.random.Generator) -> None:
        """Bring the particles to ``stamp_ns``, through every change of twist on the way."""
        if self._stamp_ns is None:
            self._stamp_ns = stamp_ns
        while self._coming and self._coming[0].from_ns <= max(stamp_ns, self._stamp_ns):
            change = self._coming.pop(0)
            self._hold(change.from_ns, rng)
            self._twist = Twist(change.v, change.w)
        self._hold(stamp_ns, rng)

    def _hold(self, stamp_ns: int, rng: np.random.Generator) -> None:
        """Move the particles and dead reckoning up to ``stamp_ns`` under the twist in force."""
        assert self._stamp_ns is not None
        duration = (stamp_ns - self._stamp_ns) / NANOSECONDS
        if duration <= 0.0:
            return
        self._cloud = self._filter.predict(self._cloud, self._twist, duration, rng)
        arc = arc_displacement(self._twist.v * duration, self._twist.w * duration)
        self._reckoned = compose(self._reckoned, arc)
        self._stamp_ns = stamp_ns

    def _report(self) -> list[Output]:
        assert self._stamp_ns is not None
        weights = self._cloud.weights
        mean, covariance = pose_estimate(self._cloud.particles, weights)
        x, y, theta = mean.tolist()
        when = timestamp(self._stamp_ns)
        outputs = [
            Output(
                "estimator/state",
                Estimate(
                    x=x,
                    y=y,
                    theta=theta,
                    covariance=tuple(covariance.ravel().tolist()),
                    n_eff=effective_sample_size(weights),
                ),
            ),
            Output("estimator/pose", PoseInFrame(timestamp=when, frame_id=frames.MAP, pose=planar_pose(x, y, theta))),
            Output(
                "estimator/dead_reckoning",
                PoseInFrame(timestamp=when, frame_id=frames.MAP, pose=planar_pose(*self._reckoned.tolist())),
            ),
        ]
        if self._shown_ns is None or self._stamp_ns - self._shown_ns >= SHOWN_PERIOD_NS:
            self._shown_ns = self._stamp_ns
            outputs.append(Output("estimator/particles", self._shown_particles(weights)))
            outputs.append(Output("estimator/transforms", robot_transform(x, y, theta, when)))
        if self._scene_ns is None or self._stamp_ns - self._scene_ns >= SCENE_PERIOD_NS:
            self._scene_ns = self._stamp_ns
            outputs.append(Output("estimator/scene", draw_scene(x, y, theta, self._marks, when)))
        return outputs

    def _shown_particles(self, weights: np.ndarray[Any, np.dtype[np.float64]]) -> PosesInFrame:
        assert self._stamp_ns is not None
        # Chosen by weight, not by place, so that what is looked at is the posterior.
        chosen = systematic(weights, 0.5, min(SHOWN_PARTICLES, weights.size))
        poses = self._cloud.particles[:3, chosen].T.tolist()
        return PosesInFrame(
            timestamp=timestamp(self._stamp_ns),
            frame_id=frames.MAP,
            poses=tuple(planar_pose(x, y, theta) for x, y, theta in poses),
        )

    def _unknown_landmark(self, received: Received, landmark: int) -> Output:
        message = f"{received.topic}: landmark {landmark} is not in the map; its readings are left out"
        when = timestamp(received.stamp_ns)
        return Output("log", Log(timestamp=when, level=LogLevel.WARNING, message=message, name=self.name))


def _compose_filter(config: LocalizationConfig, landmarks: LandmarkMap) -> Sir:
    (range_bearing,) = config.measurement
    return Sir(
        _motion_model(config),
        {RangeBearingReading: RangeBearing(range_bearing, landmarks)},
        SystematicResampling(config.resampling),
    )


def _motion_model(config: LocalizationConfig) -> MotionModel:
    if config.calibration is None:
        return Arcs(config.motion)
    return CalibratedArcs(config.motion, config.calibration)
