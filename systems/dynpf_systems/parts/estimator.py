"""Estimator of the rearrangement task: a particle filter for the robot, a Kalman filter for each part.

The robot's filter draws from the optimal importance density (PARTS eq. 3.19-3.24) unless another is named, and moves
its particles with the velocity last commanded, as the robot does whatever its true position. A part is a random walk
until it is held; then it moves with the gripper, and its detections also measure the robot. Detections carry no
identity: they are associated with the robot and the parts by position, radius and the grey observed so far. Where some
look alike, ``WhoIsWho`` has the belief about who is who.
"""

import math
from typing import Any

import msgspec
import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import Command, Estimate, HostEvent, PoseInFrame, planar_pose, timestamp
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.estimates import gap_warning, particles_picture, robot_transform
from dynpf_services.scenario.context import Context
from msgspec import UNSET
from numpy.typing import NDArray

from dynpf.filters.association import associate
from dynpf.portable import log, sincos
from dynpf.rng import Stream
from dynpf.types import FloatArray
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.identities import Look, WhoIsWho
from dynpf_systems.parts.messages import Detections, Gripper, Identities, PartEstimate, PartsCommand, PartsEstimate
from dynpf_systems.parts.robot_filters import Belief, Seen, fused, robot_filter
from dynpf_systems.parts.task import RearrangementTask, layout_of, task_of

__all__ = ["RearrangementEstimator", "build"]


ROBOT = 0  # row of the robot among the objects to be associated; part i is row i + 1


class RearrangementEstimator:
    """Reads detections, the gripper and the last command; writes the estimates of robot and parts."""

    def __init__(
        self,
        *,
        config: RearrangementConfig,
        seed: int,
        tick_s: float,
        task: RearrangementTask,
        name: str = "estimator",
    ) -> None:
        self.name = name
        self._layout = layout_of(task)
        self._config = config
        self._shown = Every(config.particle_period_s)
        self._noise = config.noise(task)
        self._seed = seed
        self._tick_s = tick_s
        count = len(task.parts)
        self._radii = np.concatenate([[task.robot_radius], self._layout.radii])
        self._robot_filter = robot_filter(config)
        self._robot: Belief | None = None
        identities = WhoIsWho(task, config, self._noise)
        self._identities = identities if identities.needed else None
        self._parts = np.zeros((count, 2))
        self._variances = np.full(count, config.prior_variance)
        expected = [config.robot_grey, *[config.part_grey] * count]
        # Zero where the grey is not known yet.
        self._greys = np.array([0.0 if grey is None else grey for grey in expected])
        self._toned = np.array([grey is not None for grey in expected])
        self._missed = np.zeros(count + 1, dtype=np.int64)
        self._seen = np.zeros(count, dtype=bool)
        self._located = np.zeros(count, dtype=bool)
        self._command = Command()
        self._handling = PartsCommand(mode="idle")
        self._stamp_ns = -1
        self._theta = 0.0
        self._contact = False
        self._held = -1
        self._shown_ns: int | None = None

    def step(self, step: Step) -> Result:
        """Update the filters by the detections; return the estimates once every object has been located."""
        detections: Detections | None = None
        logs: list[Output] = []
        for item in step.inputs:
            match item.message:
                case Command():
                    self._command = item.message
                case PartsCommand():
                    self._handling = item.message
                case Gripper():
                    self._theta = math.remainder(item.message.theta, math.tau)
                    self._contact = item.message.contact
                case Detections():
                    detections = item.message
                case HostEvent():
                    logs.append(gap_warning(item.message, step.stamp_ns, self.name))
        self._held = self._handling.target if self._contact and self._handling.grip else -1
        elapsed_s = 0.0 if self._stamp_ns < 0 else max(step.stamp_ns - self._stamp_ns, 0) / 1e9
        self._stamp_ns = step.stamp_ns
        self._filter(detections, elapsed_s, step.number)
        if self._robot is None or not self._located.all():
            return Result(tuple(logs))
        return Result((*self._outputs(self._robot, step), *logs))

    def rehearse(self) -> None:
        """See Rehearsing."""
        stream = Stream.of(self._seed, self.name, 0, "rehearsal")
        seen = Seen(np.zeros(2), self._noise.measurement)
        self._robot_filter.rehearse(seen, self._noise.process, stream)

    def freeze(self) -> State:
        """Return the beliefs, the learnt greys, counters and the last commands."""
        state: dict[str, Any] = {
            "robot": None if self._robot is None else self._robot.freeze(),
            "parts": self._parts.copy(),
            "variances": self._variances.copy(),
            "greys": self._greys.copy(),
            "toned": self._toned.copy(),
            "missed": self._missed.copy(),
            "seen": self._seen.copy(),
            "located": self._located.copy(),
            "stamp_ns": self._stamp_ns,
            "command": msgspec.to_builtins(self._command),
            "handling": msgspec.to_builtins(self._handling),
            "theta": self._theta,
            "contact": self._contact,
            "held": self._held,
            "shown_ns": self._shown_ns,
        }
        if self._identities is not None:
            state["identities"] = self._identities.freeze()
        return state

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._robot = None if state["robot"] is None else Belief.thaw(state["robot"])
        self._parts, self._variances = state["parts"].copy(), state["variances"].copy()
        self._greys, self._toned, self._missed = (state[name].copy() for name in ("greys", "toned", "missed"))
        self._seen, self._located = state["seen"].copy(), state["located"].copy()
        self._stamp_ns = state["stamp_ns"]
        self._command = msgspec.convert(state["command"], Command)
        self._handling = msgspec.convert(state["handling"], PartsCommand)
        self._theta, self._contact = state["theta"], state["contact"]
        self._held, self._shown_ns = state["held"], state["shown_ns"]
        if self._identities is not None:
            self._identities.thaw(state["identities"])

    def _filter(self, detections: Detections | None, elapsed_s: float, number: int) -> None:
        """Predict, associate the detections, and update: first the robot, then the parts."""
        ticks = elapsed_s / self._tick_s
        shift = np.array([self._command.vx, self._command.vy]) * elapsed_s
        variance = self._noise.process * ticks
        self._variances = self._variances + self._config.part_process_variance * ticks
        measured = _Measured.of(detections)
        costs = self._costs(measured, *self._predictions(shift, variance))
        if self._identities is not None:
            for tracks, *predictions in self._identities.predictions(shift, variance):
                others = self._costs(measured, *predictions)
                costs = np.where(tracks[:, None], np.minimum(costs, others), costs)
        matches = associate(costs, self._config.miss_cost)
        self._seen = matches[1:] >= 0
        if detections is not None:
            self._remember(matches, measured)
        stream = Stream.of(self._seed, self.name, number, "robot")
        moved: Seen | None = None
        if self._identities is not None and detections is not None:
            matches, moved = self._identify(self._identities, matches, measured, Seen(shift, variance))
        seen = fused(self._sights(matches, measured)) if moved is None else moved
        if self._robot is not None:
            self._robot = self._robot_filter.step(self._robot, shift, variance, seen, stream)
        elif seen is not None:
            self._robot = self._robot_filter.start(seen, stream)
        self._update_parts(matches[1:], measured)

    def _identify(
        self, identities: WhoIsWho, matches: NDArray[np.intp], measured: "_Measured", motion: Seen
    ) -> tuple[NDArray[np.intp], Seen | None]:
        """Update the identities, and give other tracks their names where that has become more likely.

        ``motion`` is the robot's since the last step. Returns the matches by the new names, and where the robot is if
        its track is another now.
        """
        seen, at = matches >= 0, np.maximum(matches, 0)
        if not seen.any():
            return matches, None
        found = np.append(self._robot is not None, self._located)
        lost = ~seen & (~found | (self._missed >= self._config.lost_after))
        look = Look(seen, measured.centres[at], measured.radii[at], measured.colours[at])
        identities.update(look, lost, self._held, *motion)
        order = identities.better()
        if order is None:
            return matches, None
        identities.rename(order)
        self._missed, self._greys, self._toned = self._missed[order], self._greys[order], self._toned[order]
        renamed, found = order != np.arange(len(order)), found[order]
        self._located = found[1:]
        parts, variances = identities.part_positions()
        self._parts = np.where(renamed[1:, None], parts, self._parts)
        variances = np.minimum(variances, self._config.prior_variance)
        self._variances = np.where(renamed[1:], variances, self._variances)
        self._seen = matches[order][1:] >= 0
        if not renamed[ROBOT]:
            return matches[order], None
        self._robot = None
        return matches[order], identities.robot_position() if found[ROBOT] else None

    def _predictions(self, shift: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
        """Return the predicted positions of the objects, (p + 1, 2), and the variances of a coordinate, (p + 1,)."""
        predicted = np.zeros((len(self._radii), 2))
        variances = np.full(len(self._radii), self._config.prior_variance)
        predicted[1:], variances[1:] = self._parts, self._variances
        if self._robot is not None:
            predicted[ROBOT] = self._robot.mean + shift
            variances[ROBOT] = self._robot.variance + variance
            if self._held >= 0:
                predicted[self._held + 1] = predicted[ROBOT] + self._grip_offset(self._held)
                variances[self._held + 1] = variances[ROBOT] + self._swing_variance(self._held)
        return predicted, variances

    def _costs(self, measured: "_Measured", predicted: FloatArray, variances: FloatArray) -> FloatArray:
        """Return the negative log-likelihoods, (objects, detections), infinite outside the gates."""
        config = self._config
        innovation_variance = (variances + self._noise.measurement)[:, None]
        aside, ahead = (measured.centres[:, axis] - predicted[:, axis, None] for axis in (0, 1))
        distance = (aside * aside + ahead * ahead) / innovation_variance
        radius_error = measured.radii - self._radii[:, None]
        grey_error = np.where(self._toned[:, None], measured.greys - self._greys[:, None], 0.0)
        grey_cost = np.minimum(np.square(grey_error / config.grey_sigma), config.gate)
        costs: FloatArray = 0.5 * (
            distance + 2.0 * log(innovation_variance) + np.square(radius_error / config.radius_sigma) + grey_cost
        )
        costs[(distance > config.gate) | (np.abs(radius_error) > config.radius_gate)] = np.inf
        return costs

    def _remember(self, matches: NDArray[np.intp], measured: "_Measured") -> None:
        """Learn the greys of associated objects, and forget the position of an object missed for too long."""
        found = matches >= 0
        greys = measured.greys[matches[found]]
        known = self._greys[found]
        self._greys[found] = np.where(self._toned[found], 0.9 * known + 0.1 * greys, greys)
        self._toned = self._toned | found
        self._located = self._located | self._seen
        if self._held >= 0:  # robot and held part locate each other
            found[[ROBOT, self._held + 1]] = found[ROBOT] or found[self._held + 1]
        self._missed = np.where(found, 0, self._missed + 1)
        forgotten = self._missed >= self._config.lost_after
        self._variances = np.where(forgotten[1:], self._config.prior_variance, self._variances)
        if forgotten[ROBOT]:
            self._robot = None  # the next detection restarts the filter

    def _sights(self, matches: NDArray[np.intp], measured: "_Measured") -> list[Seen]:
        """Return the position readings of the robot: from its own disc, and from that of the part in its gripper."""
        noise = self._noise.measurement
        seen = [Seen(measured.centres[matches[ROBOT]], noise)] if matches[ROBOT] >= 0 else []
        if self._held >= 0 and matches[self._held + 1] >= 0:
            position = measured.centres[matches[self._held + 1]] - self._grip_offset(self._held)
            seen.append(Seen(position, noise + self._swing_variance(self._held)))
        return seen

    def _update_parts(self, matches: NDArray[np.intp], measured: "_Measured") -> None:
        """Update the parts by their detections, with Kalman filters of random walks (PARTS table 3.2)."""
        held = self._held if self._robot is not None else -1
        free = self._seen.copy()
        if held >= 0 and self._robot is not None:
            self._parts[held] = self._robot.mean + self._grip_offset(held)
            self._variances[held] = self._robot.variance + self._swing_variance(held)
            free[held] = False
        gains = (self._variances / (self._variances + self._noise.measurement))[free]
        self._parts[free] += gains[:, None] * (measured.centres[matches[free]] - self._parts[free])
        self._variances[free] *= 1.0 - gains

    def _grip_offset(self, part: int) -> FloatArray:
        distance = self._layout.grip_distance(part)
        sine, cosine = sincos(self._theta)
        return np.array([distance * cosine, distance * sine])

    def _swing_variance(self, part: int) -> float:
        """Return the variance, across the arm, that the gripper's angle adds to the position of a held part."""
        distance = self._layout.grip_distance(part)
        return self._config.encoder_variance * (distance * distance)

    def _outputs(self, robot: Belief, step: Step) -> tuple[Output, ...]:
        x, y = robot.mean.tolist()
        (xx, xy), (yx, yy) = robot.covariance.tolist()
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
            covariance=(xx, xy, 0.0, yx, yy, 0.0, 0.0, 0.0, self._config.encoder_variance),
            n_eff=robot.n_eff,
        )
        stamp = timestamp(step.stamp_ns)
        pose = PoseInFrame(timestamp=stamp, frame_id=frames.MAP, pose=planar_pose(x, y, self._theta))
        outputs = [Output("estimator/parts", PartsEstimate(parts=parts, held=self._held))]
        if self._identities is not None:
            robot_is, *parts_are = self._identities.certainties.tolist()
            among = self._identities.robot_among
            certain = Identities(robot=robot_is, parts=tuple(parts_are), robot_among=among)
            outputs.append(Output("estimator/identities", certain))
        # The state triggers its readers, so it comes after what belongs to it.
        outputs += [Output("estimator/state", estimate), Output("estimator/pose", pose)]
        if self._shown.due(step.stamp_ns, self._shown_ns):
            self._shown_ns = step.stamp_ns
            shown = np.vstack((robot.shown, np.full(robot.shown.shape[1], self._theta)))
            outputs.append(Output("estimator/particles", particles_picture(shown, stamp)))
            outputs.append(Output("estimator/transforms", robot_transform(x, y, self._theta, stamp)))
        return tuple(outputs)


class _Measured(msgspec.Struct, frozen=True):
    """Detections as arrays: centres (m, 2), radii (m,), greys (m,), colours (m, 3), NaN without any."""

    centres: FloatArray
    radii: FloatArray
    greys: FloatArray
    colours: FloatArray

    @classmethod
    def of(cls, detections: Detections | None) -> "_Measured":
        """Return the detections as arrays, empty without a message."""
        discs = () if detections is None else detections.discs
        table = np.array([(disc.x, disc.y, disc.radius, disc.grey) for disc in discs]).reshape(-1, 4)
        colours = [(math.nan,) * 3 if disc.colour is UNSET else disc.colour for disc in discs]
        return cls(table[:, :2], table[:, 2], table[:, 3], np.array(colours).reshape(-1, 3))


def build(config: RearrangementConfig, context: Context) -> RearrangementEstimator:
    """Return the estimator of a run."""
    return RearrangementEstimator(
        config=config, seed=context.seed, tick_s=context.tick_s, task=task_of(context), name=context.name
    )
