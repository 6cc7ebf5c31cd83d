"""Log sensors: the records of an imported log as sensor messages, normalized.

A reading of a landmark that is not on the map (a misread barcode), and does not tell where it was, is dropped; a record
that no sensor could have given is refused. Both are counted in the state.
"""

import math

import msgspec
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import LandmarkReading, LandmarkReadings, LaserScan, Message, Odometry, OdometryPose
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context

from dynpf_systems.rooms.sensors.config import LogSensorsConfig

__all__ = ["LogSensors", "build"]


class LogSensors:
    """Sensor publisher fed by an imported log; the source of its run."""

    def __init__(
        self,
        *,
        config: LogSensorsConfig,
        landmarks: tuple[Landmark, ...] = (),
        name: str = "sensors",
    ) -> None:
        self.name = name
        self.config = config
        self.landmarks = landmarks
        self._known = frozenset(landmark.id for landmark in landmarks)
        self._unknown = 0
        self._refused = 0

    def step(self, step: Step) -> Result:
        outputs = []
        for received in step.inputs:
            message = self._normalize(received.message)
            if message is not None:
                outputs.append(Output(received.topic.replace("log/", "sensors/", 1), message))
        return Result(tuple(outputs))

    def _normalize(self, message: Message) -> Message | None:
        match message:
            case Odometry():
                return self._accept(message, _finite((message.v, message.w)))
            case OdometryPose():
                return self._accept(message, _finite((message.x, message.y, message.theta)))
            case LaserScan():
                numbers = (message.start_angle, message.end_angle, *message.ranges)
                return self._accept(message, bool(message.ranges) and _finite(numbers) and min(message.ranges) >= 0.0)
            case LandmarkReadings():
                readings = tuple(reading for reading in map(self._reading, message.readings) if reading is not None)
                return LandmarkReadings(readings=readings) if readings else None
            case _:
                return None

    def _reading(self, reading: LandmarkReading) -> LandmarkReading | None:
        if reading.landmark not in self._known and reading.x is msgspec.UNSET:
            self._unknown += 1
            return None
        if not (_finite((reading.range, reading.bearing)) and reading.range >= 0.0):
            self._refused += 1
            return None
        return msgspec.structs.replace(reading, bearing=math.remainder(reading.bearing, math.tau))

    def _accept(self, message: Message, good: bool) -> Message | None:
        if good:
            return message
        self._refused += 1
        return None

    def freeze(self) -> State:
        return {"unknown": self._unknown, "refused": self._refused}

    def thaw(self, state: State) -> None:
        self._unknown = state["unknown"]
        self._refused = state["refused"]


def _finite(numbers: tuple[float, ...]) -> bool:
    return all(map(math.isfinite, numbers))


def build(config: LogSensorsConfig, context: Context) -> LogSensors:
    """Return the sensors of a run."""
    return LogSensors(config=config, landmarks=context.fact("landmarks") or (), name=context.name)
