"""Log sensors: publishes the valid records of an imported log as sensor messages.

Each sensor kind checks its own records. The state counts what is left out.
"""

from collections import Counter

import msgspec
from dynpf_runtime.node import Output, Result, State, Step

from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import NodeKind, sensor_kinds
from dynpf_services.sensors.kind import SensorKind

__all__ = ["KIND", "LogSensors", "LogSensorsConfig", "build"]


class LogSensorsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="log"
):
    """Sensors that publish the records of an imported log."""


class LogSensors:
    """Sensor publisher fed by an imported log; the source of its run."""

    def __init__(self, context: Context) -> None:
        self.name = context.name
        self._checks = {_record(kind): (kind, kind.checked(context)) for kind in sensor_kinds() if kind.checked}
        self._left_out: dict[str, Counter[str]] = {}

    def step(self, step: Step) -> Result:
        """Publish the valid parts of the records, in their order."""
        outputs = []
        for received in step.inputs:
            kind, check = self._checks[received.topic]
            message, reasons = check(received.message)
            for reason in reasons:
                self._left_out.setdefault(kind.name, Counter())[reason] += 1
            if message is not None:
                outputs.append(Output(kind.topic, message))
        return Result(tuple(outputs))

    def freeze(self) -> State:
        """Return the counts of what was left out, by sensor and reason."""
        return {"left_out": {name: dict(counts) for name, counts in self._left_out.items()}}

    def thaw(self, state: State) -> None:
        """Restore a state that ``freeze`` returned."""
        self._left_out = {name: Counter(counts) for name, counts in state["left_out"].items()}


def _record(kind: SensorKind) -> str:
    return f"log/{kind.name}"


def _logged() -> list[SensorKind]:
    return [kind for kind in sensor_kinds() if kind.checked is not None]


def build(_config: LogSensorsConfig, context: Context) -> LogSensors:
    """Return the sensors of a run."""
    return LogSensors(context)


KIND = NodeKind(
    config=LogSensorsConfig,
    build="dynpf_services.sensors.log:build",
    reads=lambda *_: {_record(kind) for kind in _logged()},
    writes=lambda *_: {kind.topic: kind.row for kind in _logged()},
    plays_log=True,
)
