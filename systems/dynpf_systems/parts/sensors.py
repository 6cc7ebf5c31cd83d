"""The sensors of a robot that moves parts: an overhead tracker, and those of its gripper."""

import math
from typing import Annotated

from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import Message
from dynpf_services.scenario.context import Context
from dynpf_services.sensors.kind import Read, SensorKind, SensorTable, Simulated, Truth
from msgspec import UNSET, Meta

from dynpf.portable import hypot
from dynpf.rng import Draws
from dynpf.types import NonNegative, Share
from dynpf_systems.parts.messages import Detection, Detections, Gripper, PartsState
from dynpf_systems.parts.task import RearrangementTask

__all__ = ["SENSORS", "GripperSensor", "OverheadSensor"]


PARTS = "truth/parts"


class OverheadSensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An overhead tracker of robot and parts, for runs without camera frames.

    Grey levels distinguish robot and parts as in the camera's frames: the robot is darker than the background, parts
    are brighter.
    """

    variance: NonNegative | None = None  # m^2, of each coordinate; absent: that of the task's noise
    radius_std: NonNegative = 0.0  # m
    miss_probability: Share = 0.0  # of each disc in each frame
    clutter_rate: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0  # mean number of false discs a frame
    robot_grey: float = -60.0  # grey levels less the background's
    part_grey: float = 60.0


class GripperSensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contact switch and angle encoder of the gripper."""

    tolerance: NonNegative = 0.002  # m beyond the gripper's reach at which the switch still closes
    theta_std: NonNegative = 0.0  # rad


def _task(context: Context, sensor: str) -> RearrangementTask:
    task: RearrangementTask | None = context.fact("task")
    if task is None:
        raise ScenarioError(f"sensors.{sensor} needs a rearrangement task; this run has none")
    return task


def _overhead(sensor: OverheadSensor, context: Context) -> Read:
    task = _task(context, "overhead")
    std = math.sqrt(task.variances.measurement if sensor.variance is None else sensor.variance)

    def read(truth: Truth, draws: Draws) -> Detections | None:
        """Return noisy discs in random order, without identities and without hidden parts."""
        parts = truth.others.get(PARTS)
        if not isinstance(parts, PartsState):
            return None
        true = [(truth.robot.x, truth.robot.y, task.robot_radius, sensor.robot_grey)]
        true += [(part.x, part.y, part.radius, sensor.part_grey) for part in parts.parts]
        colours = [*task.colours, *[None] * len(true)][: len(true)]  # a truth may be of another task's parts
        missed = draws.random(len(true)) < sensor.miss_probability
        missed[[part + 1 for part in parts.hidden]] = True
        noise = draws.standard_normal((len(true), 3)).tolist()
        discs = [
            Detection(
                x=x + std * dx,
                y=y + std * dy,
                radius=max(radius + sensor.radius_std * dr, radius / 10),  # stays positive for any noise
                grey=grey,
                colour=UNSET if colour is None else (float(colour[0]), float(colour[1]), float(colour[2])),
            )
            for (x, y, radius, grey), colour, (dx, dy, dr), miss in zip(
                true, colours, noise, missed.tolist(), strict=True
            )
            if not miss
        ]
        discs += _clutter(sensor, true, task, draws)
        order = draws.permutation(len(discs)).tolist()
        return Detections(discs=tuple(discs[index] for index in order))

    return read


def _clutter(
    sensor: OverheadSensor,
    true: list[tuple[float, float, float, float]],
    task: RearrangementTask,
    draws: Draws,
) -> list[Detection]:
    """Return false discs, uniform in the workspace, with the radii and greys of true ones."""
    count = min(draws.poisson(sensor.clutter_rate), 256 - len(true))
    x = draws.uniform(-task.width / 2, task.width / 2, count).tolist()
    y = draws.uniform(-task.height / 2, task.height / 2, count).tolist()
    like = draws.integers(0, len(true), count).tolist()
    return [Detection(x=x[i], y=y[i], radius=true[like[i]][2], grey=true[like[i]][3]) for i in range(count)]


def _gripper(sensor: GripperSensor, context: Context) -> Read:
    task = _task(context, "gripper")
    within = task.robot_radius + task.reach + sensor.tolerance

    def read(truth: Truth, draws: Draws) -> Gripper | None:
        """Return the gripper's reading; the switch is closed while a part is held or within reach of the rim."""
        robot, parts = truth.robot, truth.others.get(PARTS)
        if not isinstance(parts, PartsState):
            return None
        touching = any(hypot(part.x - robot.x, part.y - robot.y) - part.radius <= within for part in parts.parts)
        theta = robot.theta + sensor.theta_std * float(draws.standard_normal())
        return Gripper(contact=parts.held >= 0 or touching, theta=math.remainder(theta, math.tau))

    return read


def _seen(_context: Context) -> dict[str, type[Message]]:
    return {PARTS: PartsState}


SENSORS = (
    SensorKind(name="overhead", message=Detections, simulated=Simulated(OverheadSensor, _overhead, _seen)),
    SensorKind(name="gripper", message=Gripper, simulated=Simulated(GripperSensor, _gripper, _seen)),
)
