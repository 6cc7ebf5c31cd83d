"""Events: everything that can happen to a process of a run."""

from collections.abc import Iterator
from typing import NamedTuple

from dynpf_formats.recording.header import RunEnd
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import ProtocolError, TooLargeError

__all__ = [
    "Answered",
    "Arrived",
    "Closed",
    "Counted",
    "Dropped",
    "Event",
    "Flushed",
    "Found",
    "FoundMessage",
    "Now",
    "RouterGone",
    "Started",
    "StopAsked",
    "Token",
    "Woke",
]


class Now(NamedTuple):
    """The time at which an event is handled."""

    monotonic_ns: int  # for intervals
    wall_ns: int  # for envelopes


class Started(NamedTuple):
    """The process is connected to the bus: the first event."""


class Arrived(NamedTuple):
    """A message was published under a key that the process has subscribed to."""

    key: str
    payload: bytes
    attachment: bytes


class Dropped(NamedTuple):
    """Messages came faster than this process takes them, and some were dropped, the first of them under ``key``."""

    key: str
    messages: int

    @property
    def error(self) -> ProtocolError:
        """Why they were not accepted."""
        return TooLargeError(f"{self.messages} messages were dropped: they came faster than this process takes them")


class Token(NamedTuple):
    """A watched liveliness token has appeared or disappeared."""

    key: str
    present: bool


class Answered(NamedTuple):
    """The answer to Ask; None if there was none."""

    payload: bytes | None


class Counted(NamedTuple):
    """The answer to Count of ``key``: the liveliness tokens present."""

    key: str
    keys: tuple[str, ...]


class StopAsked(NamedTuple):
    """The user asks this process to end: cleanly with the run, or, when asked again, at once."""

    reason: str
    at_once: bool


class RouterGone(NamedTuple):
    """The connection to the bus is lost."""


class Woke(NamedTuple):
    """The machine's ``wake_ns`` has come, and no arrival waits to be handled."""


class Closed(NamedTuple):
    """The answer to Close: how the recording ended."""

    end: RunEnd


class Flushed(NamedTuple):
    """The answer to Flush: all that has been recorded so far is handed to the operating system."""


class FoundMessage(NamedTuple):
    """A message of a recording; the envelope's tick is of no meaning."""

    topic: str
    envelope: Envelope
    payload: bytes


class Found(NamedTuple):
    """The answer to Open: what another start of the recorder has recorded, in the order of the file."""

    messages: Iterator[FoundMessage]


Event = (
    Started | Arrived | Dropped | Token | Answered | Counted | StopAsked | RouterGone | Woke | Closed | Flushed | Found
)
