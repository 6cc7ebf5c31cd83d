"""Effects: all that the machine of a process can ask of the world around it."""

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import JournalEntry

from dynpf_runtime.machines.events import Event, Now

__all__ = [
    "NEVER_NS",
    "Answer",
    "Ask",
    "Close",
    "Count",
    "Declare",
    "Effect",
    "Ended",
    "Flush",
    "Machine",
    "Open",
    "Put",
    "Record",
    "Show",
    "Subscribe",
    "Tell",
    "Watch",
]

NEVER_NS = 2**63 - 1
"""Later than anything."""


class Put(NamedTuple):
    """Publish."""

    key: str
    payload: bytes
    attachment: bytes = b""


class Subscribe(NamedTuple):
    """Let what is published under ``key`` arrive; ``*`` stands for one part of a key, ``**`` for any number."""

    key: str


class Watch(NamedTuple):
    """Tell of the liveliness tokens that match ``key``, those already there included."""

    key: str


class Declare(NamedTuple):
    """Put up a liveliness token that is gone when this process is."""

    key: str


class Answer(NamedTuple):
    """Answer from now on with ``payload`` whoever asks for ``key``."""

    key: str
    payload: bytes


class Ask(NamedTuple):
    """Ask whoever answers for ``key``; Answered follows."""

    key: str


class Count(NamedTuple):
    """Ask the router which liveliness tokens match ``key``; Counted follows."""

    key: str


class Tell(NamedTuple):
    """Tell the person at the terminal."""

    text: str


class Open(NamedTuple):
    """Open the recording."""


class Record(NamedTuple):
    """Write a message, or the ``entry`` of a journal that its payload holds, into the recording."""

    topic: str
    envelope: Envelope
    payload: bytes
    entry: JournalEntry | None = None


class Flush(NamedTuple):
    """Hand to the operating system what has waited long enough by now."""

    now_ns: int


class Close(NamedTuple):
    """Close the recording; Closed follows."""

    complete: bool
    reason: str


class Show(NamedTuple):
    """Show how far the run has come to whoever watches."""

    ticks: int
    messages: int


class Ended(NamedTuple):
    """The process is done; ``error`` is what it could not be done for. No event follows."""

    error: BaseException | None = None


Effect = Put | Subscribe | Watch | Declare | Answer | Ask | Count | Tell | Open | Record | Flush | Close | Show | Ended


class Machine(Protocol):
    """A process of a run without the world around it.

    Between two events all effects of the first are to be carried out, in their order.
    """

    @property
    def wake_ns(self) -> int:
        """When on the monotonic clock Woke is due, unless something happens before."""

    def handle(self, event: Event, now: Now) -> Iterable[Effect]: ...
