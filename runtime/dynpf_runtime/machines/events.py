"""Events: all that can happen to a process of a run, as its machine is told of it."""

from typing import NamedTuple

from dynpf_formats.recording.header import RunEnd

__all__ = [
    "Answered",
    "Arrived",
    "Closed",
    "Counted",
    "Event",
    "Now",
    "RouterGone",
    "Started",
    "StopAsked",
    "Token",
    "Woke",
]


class Now(NamedTuple):
    """When an event is handled."""

    monotonic_ns: int  # for intervals
    wall_ns: int  # for envelopes


class Started(NamedTuple):
    """The process is connected to the bus: the first event."""


class Arrived(NamedTuple):
    """Something published under a key that the process has subscribed."""

    key: str
    payload: bytes
    attachment: bytes


class Token(NamedTuple):
    """A liveliness token that the process watches has appeared, or is gone."""

    key: str
    present: bool


class Answered(NamedTuple):
    """What came of Ask; None if nobody answered."""

    payload: bytes | None


class Counted(NamedTuple):
    """What came of Count: the liveliness tokens that were there."""

    keys: tuple[str, ...]


class StopAsked(NamedTuple):
    """Somebody wants this process to end: with the run in good order, or, when asked again, at once."""

    reason: str
    at_once: bool


class RouterGone(NamedTuple):
    """The connection to the bus is lost."""


class Woke(NamedTuple):
    """The moment of the machine's ``wake_ns`` has come, and nothing that arrived waits to be handled."""


class Closed(NamedTuple):
    """What came of Close: how the recording ended."""

    end: RunEnd


Event = Started | Arrived | Token | Answered | Counted | StopAsked | RouterGone | Woke | Closed
