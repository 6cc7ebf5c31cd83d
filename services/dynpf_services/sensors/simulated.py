"""Simulated sensors: publishes the readings of the configured sensors at each new true state."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.messages import Message, RobotState
from dynpf_protocol.topics import Topic
from dynpf_runtime.node import Output, Rehearsing, Result, State, Step

from dynpf.rng import generator
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import NodeKind, sensor_kind, sensor_kinds
from dynpf_services.sensors.kind import Read, Remembering, SensorKind, Truth

__all__ = ["KIND", "SimulatedSensors", "SimulatedSensorsConfig", "build"]

ROBOT = "truth/robot"

SimulatedSensorsConfig: Any = msgspec.defstruct(
    "SimulatedSensorsConfig",
    [(kind.name, kind.simulated.table | None, None) for kind in sensor_kinds() if kind.simulated is not None],
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="simulated",
    module=__name__,
    namespace={"__doc__": "Sensors that observe the simulator's true state; each has a table of its own."},
)
"""The table of the node: a table for each sensor that a system lists."""


class _Fitted(NamedTuple):
    """A sensor of the run; ``announcement`` is its message before its first reading."""

    kind: SensorKind
    every: int
    read: Read
    announcement: Output | None


class SimulatedSensors:
    """Sensor publisher fed by the simulator's truth.

    It publishes only when a newer truth/robot has arrived. A sensor's ``every`` counts true states, so that it means
    the same under either clock. Raises ScenarioError for a sensor whose facts (landmarks, walls, map) the run lacks.
    """

    def __init__(self, config: Any, context: Context) -> None:
        self.name = context.name
        self._seed = context.seed
        self._sensors = [_fitted(kind, getattr(config, kind.name), context) for kind in _configured(config)]
        self._seen = _seen(config, context)
        self._truth: dict[str, Message] = {}
        self._stamps_ns: dict[str, int] = {}
        self._announced: set[str] = set()
        self._states = 0

    def step(self, step: Step) -> Result:
        """Publish readings of the newest true state, if there is a new one."""
        if not self._take(step):
            return Result()
        robot = self._truth[ROBOT]
        assert isinstance(robot, RobotState)
        outputs = tuple(self._read(Truth(step.stamp_ns, robot, self._truth), step.number))
        self._states += 1
        return Result(outputs)

    def _take(self, step: Step) -> bool:
        """Keep the newest true states; return whether the robot's is new."""
        fresh = False
        for received in step.inputs:
            topic = received.topic
            if topic in self._seen and received.stamp_ns > self._stamps_ns.get(topic, -1):
                self._truth[topic], self._stamps_ns[topic] = received.message, received.stamp_ns
                fresh = fresh or topic == ROBOT
        return fresh

    def _read(self, truth: Truth, number: int) -> Iterator[Output]:
        for kind, every, read, announcement in self._sensors:
            if self._states % every != 0:
                continue
            reading = read(truth, generator(self._seed, self.name, number, kind.name))
            if reading is None:
                continue
            if announcement is not None and kind.name not in self._announced:
                self._announced.add(kind.name)
                yield announcement
            yield Output(kind.topic, reading)

    def rehearse(self) -> None:
        """Rehearse the sensors; see Rehearsing."""
        for sensor in self._sensors:
            if isinstance(sensor.read, Rehearsing):
                sensor.read.rehearse()

    def freeze(self) -> State:
        """Return the count of true states, the newest of each topic, and each sensor's state."""
        truth = {topic: msgspec.to_builtins(message) for topic, message in self._truth.items()}
        return {
            "states": self._states,
            "truth": truth,
            "stamps_ns": dict(self._stamps_ns),
            "sensors": {sensor.kind.name: self._frozen(sensor) for sensor in self._sensors},
        }

    def _frozen(self, sensor: _Fitted) -> State:
        announced = {} if sensor.announcement is None else {"announced": sensor.kind.name in self._announced}
        return {**announced, **(sensor.read.freeze() if isinstance(sensor.read, Remembering) else {})}

    def thaw(self, state: State) -> None:
        """Restore a state that ``freeze`` returned."""
        self._states = state["states"]
        self._truth = {topic: msgspec.convert(value, self._seen[topic]) for topic, value in state["truth"].items()}
        self._stamps_ns = dict(state["stamps_ns"])
        sensors = state["sensors"]
        self._announced = {name for name in sensors if sensors[name].get("announced")}
        for sensor in self._sensors:
            if isinstance(sensor.read, Remembering):
                sensor.read.thaw(sensors[sensor.kind.name])


def _configured(config: Any) -> list[SensorKind]:
    return [kind for kind in sensor_kinds() if getattr(config, kind.name, None) is not None]


def _fitted(kind: SensorKind, table: Any, context: Context) -> _Fitted:
    assert kind.simulated is not None
    announcement = None
    if kind.announced is not None:
        announcement = Output(sensor_kind(kind.announced.name).topic, kind.announced.message(table))
    return _Fitted(kind, table.every, kind.simulated.make(table, context), announcement)


def _seen(config: Any, context: Context) -> Mapping[str, type[Message]]:
    """Return the topics of the true states that the sensors observe, with their types."""
    seen: dict[str, type[Message]] = {ROBOT: RobotState}
    for kind in _configured(config):
        assert kind.simulated is not None
        seen |= kind.simulated.sees(context)
    return seen


def _written(config: Any, _context: Context) -> dict[str, Topic]:
    kinds = _configured(config)
    kinds += [sensor_kind(kind.announced.name) for kind in kinds if kind.announced is not None]
    return {kind.topic: kind.row for kind in kinds}


def build(config: Any, context: Context) -> SimulatedSensors:
    """Return the sensors of a run."""
    return SimulatedSensors(config, context)


KIND = NodeKind(
    config=SimulatedSensorsConfig,
    build="dynpf_services.sensors.simulated:build",
    reads=_seen,
    writes=_written,
)
