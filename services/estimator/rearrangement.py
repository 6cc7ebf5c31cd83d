"""Estimator of the rearrangement task: a particle filter for the robot, a Kalman filter for each part.

The robot's filter draws from the optimal importance density and moves its particles along the velocity last commanded
(PARTS eq. 3.19-3.24). A part is a random walk until it is held; then it goes where the gripper goes, and what is
seen of it tells about the robot too. Detections carry no names: they are matched to the robot and the parts
by position, radius and the grey that each has shown so far.
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf.filters import kalman
from dynpf.filters.association import associate
from dynpf.filters.cloud import Cloud, uniform_cloud
from dynpf.filters.estimate import mean_and_covariance
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.proposal import Optimal
from dynpf.filters.resampling import Systematic
from dynpf.measurement.linear import LinearMeasurement, Observation
from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
from dynpf.rng import Stream
from protocol import frames
from protocol.messages import (
    Command,
    Detections,
    Estimate,
    Gripper,
    HostEvent,
    PartEstimate,
    PoseInFrame,
    PosesInFrame,
    planar_pose,
    timestamp,
)
from services.estimator.config import RearrangementConfig
from services.estimator.gaps import GAPS, gap_warning
from services.estimator.picture import robot_transform
from services.node import Output, Result, State, Step
from services.task import RearrangementTask, layout_of

__all__ = ["RearrangementEstimator"]

FloatArray = NDArray[np.float64]

ROBOT = 0  # row of the robot among the objects to be matched; part i is row i + 1


class RearrangementEstimator:
    """Reads detections, the gripper and the last command; writes the estimate of robot and parts."""

    name = "estimator"
    reads = frozenset({"vision/detections", "sensors/overhead", "sensors/gripper", "controller/command", GAPS})
    writes = frozenset({"estimator/state", "estimator/pose", "estimator/particles", "estimator/transforms", "log"})

    def __init__(self, *, config: RearrangementConfig, seed: int, tick_s: float, task: RearrangementTask) -> None:
        self._layout = layout_of(task)
        self._config = config
        self._seed = seed
        self._tick_s = tick_s
        count = len(task.parts)
        self._radii = np.concatenate([[task.robot_radius], self._layout.radii])
        self._cloud: Cloud | None = None
        self._parts = np.zeros((count, 2))
        self._variances = np.full(count, config.prior_variance)
        expected = [config.robot_grey, *[config.part_grey] * count]
        self._greys = np.array([np.nan if grey is None else grey for grey in expected])
        self._missed = np.zeros(count + 1, dtype=np.int64)
        self._seen = np.zeros(count, dtype=bool)
        self._located = np.zeros(count, dtype=bool)
        self._command = Command(mode="idle")
        self._stamp_ns = -1
        self._n_eff = 0.0
        self._theta = 0.0
        self._contact = False
        self._held = -1
        self._cloud_ns = -1

    def step(self, step: Step) -> Result:
        detections: Detections | None = None
        logs: list[Output] = []
        for item in step.inputs:
            match item.message:
                case Command():
                    self._command = item.message
                case Gripper():
                    self._theta = math.remainder(item.message.theta, math.tau)
                    self._contact = item.message.contact
                case Detections():
                    detections = item.message
                case HostEvent():
                    logs.append(gap_warning(item.message, step.stamp_ns))
        self._held = self._command.target if self._contact and self._command.grip else -1
        elapsed_s = 0.0 if self._stamp_ns < 0 else max(step.stamp_ns - self._stamp_ns, 0) / 1e9
        self._stamp_ns = step.stamp_ns
        self._filter(detections, elapsed_s, step.number)
        if self._cloud is None or not self._located.all():
            return Result(tuple(logs))
        return Result((*self._outputs(self._cloud, step), *logs))

    def rehearse(self) -> None:
        """See Rehearsing."""
        stream = Stream.of(self._seed, self.name, 0, "rehearsal")
        particles, origin = self._robot_filter(self._config.process_variance), np.zeros(2)
        cloud = self._begin(origin, 1, stream.part("start"))
        for readings in ([], [Observation(origin)]):
            cloud, _ = particles.update(cloud, origin, readings, stream.part("update"))
        particles.resample(cloud, readings, stream.part("resample"))

    def freeze(self) -> State:
        return {
            "cloud": None if self._cloud is None else list(self._cloud),
            "parts": self._parts.copy(),
            "variances": self._variances.copy(),
            "greys": self._greys.copy(),
            "missed": self._missed.copy(),
            "seen": self._seen.copy(),
            "located": self._located.copy(),
            "stamp_ns": self._stamp_ns,
            "n_eff": self._n_eff,
            "command": msgspec.to_builtins(self._command),
            "theta": self._theta,
            "contact": self._contact,
            "held": self._held,
            "cloud_ns": self._cloud_ns,
        }

    def thaw(self, state: State) -> None:
        self._cloud = None if state["cloud"] is None else Cloud(*state["cloud"])
        self._parts, self._variances = state["parts"].copy(), state["variances"].copy()
        self._greys, self._missed = state["greys"].copy(), state["missed"].copy()
        self._seen, self._located = state["seen"].copy(), state["located"].copy()
        self._stamp_ns, self._n_eff = state["stamp_ns"], state["n_eff"]
        self._command = msgspec.convert(state["command"], Command)
        self._theta, self._contact = state["theta"], state["contact"]
        self._held, self._cloud_ns = state["held"], state["cloud_ns"]

    def _filter(self, detections: Detections | None, elapsed_s: float, number: int) -> None:
        """Predict, match the detections, and take them in: first the robot's, then the parts'."""
        ticks = elapsed_s / self._tick_s
        motion = _Motion(
            shift=np.array([self._command.vx, self._command.vy]) * elapsed_s,
            variance=self._config.process_variance * ticks,
        )
        self._variances = self._variances + self._config.part_process_variance * ticks
        measured = _Measured.of(detections)
        predicted, variances = self._predictions(motion)
        matches = associate(self._costs(measured, predicted, variances))
        self._seen = matches[1:] >= 0
        if detections is not None:
            self._remember(matches, measured)
        self._update_robot(matches, measured, motion, Stream.of(self._seed, self.name, number, "robot"))
        for part in range(len(self._parts)):
            if part == self._held and self._cloud is not None:
                self._carry(part, self._cloud)
            elif self._seen[part]:
                self._update_part(part, measured.centres[matches[part + 1]])

    def _predictions(self, motion: "_Motion") -> tuple[FloatArray, FloatArray]:
        """Return where each object is expected, (p + 1, 2), and the variance of each coordinate, (p + 1,)."""
        predicted = np.vstack([np.zeros(2), self._parts])
        variances = np.concatenate([[self._config.prior_variance], self._variances])
        if self._cloud is not None:
            mean, covariance = mean_and_covariance(self._cloud.particles, self._cloud.weights)
            predicted[ROBOT] = mean + motion.shift
            variances[ROBOT] = covariance.trace() / 2.0 + motion.variance
            if self._held >= 0:
                predicted[self._held + 1] = predicted[ROBOT] + self._grip_offset(self._held)
                variances[self._held + 1] = variances[ROBOT]
        return predicted, variances

    def _costs(self, measured: "_Measured", predicted: FloatArray, variances: FloatArray) -> FloatArray:
        """Return the negative log-likelihood of each detection for each object, infinite outside the gates."""
        config = self._config
        innovation_variance = (variances + config.measurement_variance)[:, None]
        offset = measured.centres[None, :, :] - predicted[:, None, :]
        distance = (offset * offset).sum(axis=2) / innovation_variance
        radius_error = measured.radii[None, :] - self._radii[:, None]
        grey_error = np.nan_to_num(measured.greys[None, :] - self._greys[:, None])
        costs: FloatArray = 0.5 * (
            distance
            + 2.0 * np.log(innovation_variance)
            + (radius_error / config.radius_sigma) ** 2
            + (grey_error / config.grey_sigma) ** 2
        )
        costs[(distance > config.gate) | (np.abs(radius_error) > config.radius_gate)] = np.inf
        return costs

    def _remember(self, matches: NDArray[np.intp], measured: "_Measured") -> None:
        """Learn the greys of what was matched, and forget where an object is that was missed for too long."""
        found = matches >= 0
        greys = measured.greys[matches[found]]
        known = self._greys[found]
        self._greys[found] = np.where(np.isnan(known), greys, 0.9 * known + 0.1 * greys)
        self._located = self._located | self._seen
        if self._held >= 0:  # robot and held part tell where each other is
            found[[ROBOT, self._held + 1]] = found[ROBOT] or found[self._held + 1]
        self._missed = np.where(found, 0, self._missed + 1)
        forgotten = self._missed >= self._config.lost_after
        self._variances = np.where(forgotten[1:], self._config.prior_variance, self._variances)
        if forgotten[ROBOT]:
            self._cloud = None  # the next detection starts the filter anew

    def _update_robot(
        self, matches: NDArray[np.intp], measured: "_Measured", motion: "_Motion", stream: Stream
    ) -> None:
        """Take one step of the robot's filter with what was seen of the robot and of the held part."""
        positions = [measured.centres[matches[ROBOT]]] if matches[ROBOT] >= 0 else []
        if self._held >= 0 and matches[self._held + 1] >= 0:
            positions.append(measured.centres[matches[self._held + 1]] - self._grip_offset(self._held))
        if self._cloud is None:
            if positions:
                self._cloud = self._begin(np.mean(positions, axis=0), len(positions), stream)
                self._n_eff = float(self._config.n)
            return
        readings = [Observation(position) for position in positions]
        self._cloud, report = self._robot_filter(motion.variance).update(self._cloud, motion.shift, readings, stream)
        self._n_eff = report.n_eff

    def _begin(self, position: FloatArray, count: int, stream: Stream) -> Cloud:
        """Return draws from what ``count`` measurements tell of the robot (PARTS table 3.1, step 1)."""
        sigma = math.sqrt(self._config.measurement_variance / count)
        return uniform_cloud(position[:, None] + sigma * stream.normals(2, self._config.n).astype(np.float64))

    def _robot_filter(self, variance: float) -> ParticleFilter[tuple[FloatArray, FloatArray]]:
        """Return the filter for a step whose motion has this variance: that depends on the time it took."""
        identity = ((1.0, 0.0), (0.0, 1.0))
        process = ((variance, 0.0), (0.0, variance))
        return ParticleFilter(
            LinearGaussian(LinearGaussianParams(transition=identity, noise=process, input=identity)),
            {Observation: LinearMeasurement(np.eye(2), np.eye(2) * self._config.measurement_variance)},
            proposal=Optimal(),
            resampling=Systematic(threshold=self._config.resampling_threshold),
            estimate=mean_and_covariance,
        )

    def _carry(self, part: int, cloud: Cloud) -> None:
        mean, covariance = mean_and_covariance(cloud.particles, cloud.weights)
        self._parts[part] = mean + self._grip_offset(part)
        self._variances[part] = covariance.trace() / 2.0

    def _update_part(self, part: int, centre: FloatArray) -> None:
        belief = kalman.update(
            kalman.Gaussian(self._parts[part], np.eye(2) * self._variances[part]),
            centre,
            np.eye(2),
            np.eye(2) * self._config.measurement_variance,
        )
        self._parts[part] = belief.mean
        self._variances[part] = belief.covariance[0, 0]

    def _grip_offset(self, part: int) -> FloatArray:
        return self._layout.held_position(np.array([0.0, 0.0, self._theta]), part)

    def _outputs(self, cloud: Cloud, step: Step) -> tuple[Output, ...]:
        mean, covariance = mean_and_covariance(cloud.particles, cloud.weights)
        full = np.zeros((3, 3))
        full[:2, :2] = covariance
        full[2, 2] = self._config.encoder_variance
        x, y = mean.tolist()
        parts = tuple(
            PartEstimate(x=px, y=py, variance=variance, seen=seen)
            for (px, py), variance, seen in zip(
                self._parts.tolist(), self._variances.tolist(), self._seen.tolist(), strict=True
            )
        )
        estimate = Estimate(
            x=x,
            y=y,
            theta=self._theta,
            covariance=tuple(full.ravel().tolist()),
            n_eff=self._n_eff,
            parts=parts,
            held=self._held,
        )
        stamp = timestamp(step.stamp_ns)
        pose = PoseInFrame(timestamp=stamp, frame_id=frames.MAP, pose=planar_pose(x, y, self._theta))
        outputs = [Output("estimator/state", estimate), Output("estimator/pose", pose)]
        if self._cloud_ns < 0 or step.stamp_ns - self._cloud_ns >= round(self._config.particle_period_s * 1e9):
            self._cloud_ns = step.stamp_ns
            shown = cloud.particles[:, :: math.ceil(cloud.weights.size / 200)].T.tolist()
            poses = tuple(planar_pose(px, py, self._theta) for px, py in shown)
            shown_cloud = PosesInFrame(timestamp=stamp, frame_id=frames.MAP, poses=poses)
            outputs.append(Output("estimator/particles", shown_cloud))
            outputs.append(Output("estimator/transforms", robot_transform(x, y, self._theta, stamp)))
        return tuple(outputs)


class _Motion(msgspec.Struct, frozen=True):
    """What the robot has done since the last step: the commanded shift, (2,), and its variance a coordinate."""

    shift: FloatArray
    variance: float


class _Measured(msgspec.Struct, frozen=True):
    """Detections as arrays: centres (m, 2), radii (m,), greys (m,)."""

    centres: FloatArray
    radii: FloatArray
    greys: FloatArray

    @classmethod
    def of(cls, detections: Detections | None) -> "_Measured":
        discs = () if detections is None else detections.discs
        return cls(
            np.array([(disc.x, disc.y) for disc in discs]).reshape(-1, 2),
            np.array([disc.radius for disc in discs]),
            np.array([disc.grey for disc in discs]),
        )
