"""Sensor kinds: a sensor's messages, its simulation, its check of a log's records, and its readings for filters.

Each system lists its own. The nodes of simulated sensors and of logs, and the filters that take readings, use these
lists; none of them knows a sensor by name.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec
from dynpf_protocol.messages import Message, RobotState
from dynpf_protocol.topics import TOPICS, Topic
from dynpf_runtime.node import State

from dynpf.rng import Draws
from dynpf.types import Count, Floats
from dynpf_services.scenario.context import Context

__all__ = [
    "After",
    "Announced",
    "Check",
    "ModelKind",
    "Read",
    "ReadingKind",
    "Remembering",
    "SensorKind",
    "SensorTable",
    "Simulated",
    "Truth",
    "passed",
]


class SensorTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The parameters of a simulated sensor in a scenario."""

    every: Count = 1  # true states between readings


class Truth(NamedTuple):
    """The newest true states, which a simulated sensor observes; ``others`` are those received so far, by topic."""

    stamp_ns: int  # of the reading
    robot: RobotState
    others: Mapping[str, Message] = {}


Read = Callable[[Truth, Draws], Message | None]
"""Returns a simulated sensor's reading in a true state, None for no reading. It may be Rehearsing and Remembering."""


@runtime_checkable
class Remembering(Protocol):
    """A Read with a state from reading to reading."""

    def freeze(self) -> State:
        """Return the state."""

    def thaw(self, state: State) -> None:
        """Restore a state that ``freeze`` returned."""


class Simulated(NamedTuple):
    """How a sensor is simulated.

    ``table`` is the SensorTable of its parameters. ``make`` returns the Read of a run; it raises ScenarioError, naming
    the sensor, if the run lacks a fact. ``sees`` returns the true states that it observes besides the robot's: topics
    with their types.
    """

    table: type[SensorTable]
    make: Callable[[Any, Context], Read]
    sees: Callable[[Context], Mapping[str, type[Message]]] = lambda _context: {}


class Announced(NamedTuple):
    """A message about a sensor before its first reading: the sensor kind that it belongs to, and how it is made."""

    name: str
    message: Callable[[Any], Message]


Check = Callable[[Any], tuple[Message | None, Iterable[str]]]
"""Returns the valid part of a log's record, None if there is none, and a reason for each part that is left out."""


class After(NamedTuple):
    """The sensor whose announcement another sensor's messages depend on, and an example of the announcement."""

    name: str
    example: Message


class ReadingKind(NamedTuple):
    """The type of readings that filters take of a sensor's messages; without one they take the messages themselves.

    ``of`` makes a reading of a message and the last message of the sensor that it comes ``after``, or None. ``example``
    returns a message for a robot at a pose (3,) from a run's maps and a measurement model, None if these are not
    enough; ``size`` returns the number of single readings in one.
    """

    type: type
    of: Callable[[Any, Any], Any]
    example: Callable[[Any, Floats, Any], Message | None]
    size: Callable[[Any], int] = lambda _reading: 1
    after: After | None = None


class ModelKind(NamedTuple):
    """A measurement model by the table of its parameters.

    ``reading`` is the type of its readings or messages. ``make`` takes the table, the map that it ``needs``
    ("landmarks", "grid" or "segments"), and if it is ``calibrated`` the rows of the state that hold its errors.
    """

    table: type[msgspec.Struct]
    reading: type
    make: Callable[..., Any]
    needs: str = ""
    calibrated: bool = False


class SensorKind(NamedTuple):
    """A sensor. ``name`` is its key among the simulated ones, and in its topics ``sensors/NAME`` and ``log/NAME``.

    ``checked`` returns the check of a log's records for a run; without it logs have no such records.
    """

    name: str
    message: type[Message]
    simulated: Simulated | None = None
    announced: Announced | None = None
    checked: Callable[[Context], Check] | None = None
    readings: tuple[ReadingKind, ...] = ()
    models: tuple[ModelKind, ...] = ()

    @property
    def topic(self) -> str:
        """The topic of its readings."""
        return f"sensors/{self.name}"

    @property
    def row(self) -> Topic:
        """The topic's row: that of the topic table, or one made from the message's type."""
        described = (self.message.__doc__ or self.name).strip().partition("\n")[0].rstrip(".")
        own = Topic(name=self.topic, type=self.message, publishers=("sensors",), description=described)
        return TOPICS.get(self.topic, own)


def passed(good: Callable[[Any], bool]) -> Callable[[Context], Check]:
    """Return a check that keeps messages for which ``good`` is true, and refuses the others."""

    def check(message: Message) -> tuple[Message | None, Iterable[str]]:
        return (message, ()) if good(message) else (None, ("refused",))

    return lambda _context: check
