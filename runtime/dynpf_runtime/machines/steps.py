"""Steps: what a ledger holds of each node, of steps that are open and of those that are written."""

import hashlib
from collections import Counter, defaultdict, deque

from dynpf_protocol.control import TickDone

from dynpf_runtime.machines.effects import Record
from dynpf_runtime.sequence_numbers import SeenNumbers

__all__ = ["NodeSteps", "OpenStep", "PastStep", "PlaceInTopic", "counts_of", "digest_of", "first_of"]

_WINDOW = 1000
"""How many steps of each node are remembered, to tell a late claim from a repetition."""

PlaceInTopic = tuple[str, int]
"""Topic and sequence of a message."""


class OpenStep:
    """What has come for a step that is not written yet."""

    def __init__(self) -> None:
        self.messages: dict[PlaceInTopic, Record] = {}
        self.bytes = 0  # of all that has been taken, kept or not
        self.ends: list[TickDone] = []
        self.entries: list[Record] = []


class PastStep:
    """What was written of a step, as digests, and what has come of it again."""

    def __init__(self, messages: dict[PlaceInTopic, bytes], end: TickDone | None, entry: Record | None) -> None:
        self.messages = messages
        self.end = end
        self.entry = None if entry is None else entry.payload
        self.differs = self.ended_again = False


class NodeSteps:
    """The steps of one node, of which others may not have read the last ``unread`` when all nodes have made them."""

    def __init__(self, unread: int) -> None:
        self._unread = unread
        self.written = 0  # steps
        self.ended = False
        self.next: defaultdict[str, int] = defaultdict(int)  # topic -> first sequence of the step not yet written
        self.open: defaultdict[int, OpenStep] = defaultdict(OpenStep)
        self.past: deque[PastStep] = deque(maxlen=_WINDOW)
        self.missing: set[PlaceInTopic] = set()  # messages that written steps have promised, and that have not come
        self.early: dict[
            PlaceInTopic, bytes
        ] = {}  # digests of what has been refused because its step was still to come
        self.seen: defaultdict[str, SeenNumbers] = defaultdict(SeenNumbers)  # of what no end of a tick counts

    def read(self, ticks: int) -> int:
        """Return how many of its steps all have read when all nodes have made so many."""
        return max(0, ticks - self._unread)

    def past_of(self, step: int) -> PastStep | None:
        """Return what is remembered of a written step."""
        index = step - (self.written - len(self.past))
        return self.past[index] if 0 <= index < len(self.past) else None


def digest_of(payload: bytes) -> bytes:
    """Return a digest by which the same payload is known."""
    return hashlib.blake2b(payload, digest_size=16).digest()


def first_of(step: OpenStep) -> tuple[TickDone | None, Record | None]:
    """Return the first end and the first entry that have come of a step."""
    return next(iter(step.ends), None), next(iter(step.entries), None)


def counts_of(step: OpenStep) -> dict[str, int]:
    """Return counts that leave no message out, for a step of which no end has come."""
    return Counter(topic for topic, _ in step.messages)
