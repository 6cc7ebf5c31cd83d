"""A sensor as one object: what it says, how it is simulated, what of a log is believed, and what filters make of it.

Each system lists its own. The nodes of simulated sensors and of logs, and the filters that take readings, go through
the lists; none of them knows a sensor by its name.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, NamedTuple, Protocol, runtime_checkable

import msgspec
from dynpf_protocol.messages import Message, RobotState
from dynpf_protocol.topics import TOPICS, Topic
from dynpf_runtime.node import State
from msgspec import Meta

from dynpf.rng import Draws
from dynpf.se2 import Floats
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
    """What a scenario says of a simulated sensor."""

    every: Annotated[int, Meta(ge=1)] = 1  # true states between readings


class Truth(NamedTuple):
    """What a simulated sensor looks at: the newest true states; ``others`` by topic, as far as they have come."""

    stamp_ns: int  # of the reading
    robot: RobotState
    others: Mapping[str, Message] = {}


Read = Callable[[Truth, Draws], Message | None]
"""What a simulated sensor reads in a true state, None for no reading. What it calls may be Rehearsing."""


@runtime_checkable
class Remembering(Protocol):
    """A Read that goes on from reading to reading."""

    def freeze(self) -> State:
        """Return what it remembers."""

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""


class Simulated(NamedTuple):
    """How a sensor is simulated.

    ``table`` is the SensorTable of its parameters. ``make`` returns the Read of a run; it raises ScenarioError, which
    names the sensor, where the run lacks a fact. ``sees`` returns the topics of the truth, with their types, that it
    looks at besides the robot's.
    """

    table: type[SensorTable]
    make: Callable[[Any, Context], Read]
    sees: Callable[[Context], Mapping[str, type[Message]]] = lambda _context: {}


class Announced(NamedTuple):
    """What a sensor says of itself before its first reading: under which sensor's name, and by its parameters."""

    name: str
    message: Callable[[Any], Message]


Check = Callable[[Any], tuple[Message | None, Iterable[str]]]
"""Returns a record of a log as it is believed, None if nothing of it is, and a reason for each thing left out."""


class After(NamedTuple):
    """The sensor that has to have announced something before another's messages can be read, and an example of it."""

    name: str
    example: Message


class ReadingKind(NamedTuple):
    """What a filter may take of a sensor's messages, by its type; without one, it takes the messages as they come.

    ``of`` makes it of a message, and of what the sensor that it comes ``after`` said last, else of None. ``example``
    returns the message that a robot at a pose (3,) would be sent, for a run's maps and a measurement model, None where
    they do not tell; ``size`` returns how many readings there are in one.
    """

    type: type
    of: Callable[[Any, Any], Any]
    example: Callable[[Any, Floats, Any], Message | None]
    size: Callable[[Any], int] = lambda _reading: 1
    after: After | None = None


class ModelKind(NamedTuple):
    """A measurement model by the table of its parameters.

    It takes readings of a type, or messages by theirs. It is made of the table, of the map that it ``needs``
    ("landmarks", "grid" or "segments"), and where it is ``calibrated`` of the rows of the state that hold its errors.
    """

    table: type[msgspec.Struct]
    reading: type
    make: Callable[..., Any]
    needs: str = ""
    calibrated: bool = False


class SensorKind(NamedTuple):
    """A sensor: ``name`` is its key among the simulated ones, and ends its topics: ``sensors/NAME``, ``log/NAME``.

    ``checked`` returns, for a run, what has to be so of a record of a log; without it logs have no such records.
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
        """Where the sensor says what it reads."""
        return f"sensors/{self.name}"

    @property
    def row(self) -> Topic:
        """The topic's row: that of the topic table, or one that the message's type describes."""
        described = (self.message.__doc__ or self.name).strip().partition("\n")[0].rstrip(".")
        own = Topic(name=self.topic, type=self.message, publishers=("sensors",), description=described)
        return TOPICS.get(self.topic, own)


def passed(good: Callable[[Any], bool]) -> Callable[[Context], Check]:
    """Return the check of messages that are believed as they are, or not at all."""

    def check(message: Message) -> tuple[Message | None, Iterable[str]]:
        return (message, ()) if good(message) else (None, ("refused",))

    return lambda _context: check
