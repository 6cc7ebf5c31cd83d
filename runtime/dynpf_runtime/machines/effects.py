"""Effects: everything that the machine of a process can ask its surroundings to do."""

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
    "Mend",
    "Open",
    "Put",
    "Record",
    "Show",
    "Subscribe",
    "Tell",
    "Watch",
]

NEVER_NS = 2**63 - 1
"""Later than any time."""


class Put(NamedTuple):
    """Publish a payload."""

    key: str
    payload: bytes
    attachment: bytes = b""


class Subscribe(NamedTuple):
    """Subscribe to ``key``, in which ``*`` is one part and ``**`` any number of parts; Arrived follows."""

    key: str


class Watch(NamedTuple):
    """Watch the liveliness tokens that match ``key``, including those already present; Token follows."""

    key: str


class Declare(NamedTuple):
    """Declare a liveliness token, which disappears with this process."""

    key: str


class Answer(NamedTuple):
    """Answer queries of ``key`` with ``payload`` from now on."""

    key: str
    payload: bytes


class Ask(NamedTuple):
    """Query ``key``; Answered follows, with ``wanted`` if that is among the answers, else with the first."""

    key: str
    wanted: bytes = b""


class Count(NamedTuple):
    """Query the liveliness tokens that match ``key``; Counted follows."""

    key: str


class Tell(NamedTuple):
    """Print a notice for the user."""

    text: str


class Open(NamedTuple):
    """Open the recording; Found follows if it is to be gone on with, and there is one that is not whole.

    If ``anew``, all processes of its run are gone, and it follows, too, if the run was stopped.
    """

    again: bool = False
    anew: bool = False


class Mend(NamedTuple):
    """Put the recording that has been written since Found in the place of the found one."""


class Record(NamedTuple):
    """Write a message into the recording; ``entry`` is the decoded payload if it is a journal entry."""

    topic: str
    envelope: Envelope
    payload: bytes
    entry: JournalEntry | None = None


class Flush(NamedTuple):
    """Hand the open chunk to the operating system if it is old enough; then Flushed follows."""

    now_ns: int


class Close(NamedTuple):
    """Close the recording; Closed follows."""

    complete: bool
    reason: str
    outcome: str = ""


class Show(NamedTuple):
    """Show the progress of the run."""

    ticks: int
    messages: int
    paused: bool


class Ended(NamedTuple):
    """End the process, with ``error`` if it failed. No event follows."""

    error: BaseException | None = None


Effect = (
    Put
    | Subscribe
    | Watch
    | Declare
    | Answer
    | Ask
    | Count
    | Tell
    | Open
    | Mend
    | Record
    | Flush
    | Close
    | Show
    | Ended
)


class Machine(Protocol):
    """The logic of a process of a run.

    The caller carries out all effects of an event, in their order, before it passes the next event.
    """

    @property
    def wake_ns(self) -> int:
        """The time on the monotonic clock at which Woke is due, unless another event comes before."""

    def handle(self, event: Event, now: Now) -> Iterable[Effect]:
        """Return the effects of an event."""
