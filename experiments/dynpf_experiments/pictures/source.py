"""A recording as pages read it: messages by topic and type, in order of time, bounded and without the undecodable."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from dynpf_formats.recording.reader import Recorded, Recording
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import BadMessageError, DynpfError
from dynpf_protocol.messages import Message
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import override_resolved
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.schema import Scenario
from numpy.typing import NDArray

from dynpf.types import FloatArray
from dynpf_experiments.pictures.columns import evenly

__all__ = ["Budget", "RunSource", "robot_of"]

MOST_TOPICS = 32
"""How many topics of a type are read; a file could name thousands."""


class Budget(NamedTuple):
    """How much of a run is drawn at most: moments of the slider, values of a line, and so on."""

    moments: int = 3000
    values: int = 1500
    clouds: int = 400
    readings: int = 600
    frames: int = 60
    scenes: int = 300

    def halved(self) -> "Budget":
        """Return half of it."""
        return Budget(*(max(each // 2, 4) for each in self))


class RunSource:
    """The messages of a recording; times are seconds since its first message.

    ``unreadable`` counts the messages left out because they do not decode.
    """

    def __init__(self, recording: Recording, budget: Budget) -> None:
        self.recording = recording
        self.budget = budget
        self.unreadable = 0
        self._records: dict[str, list[Recorded]] = {}

    @cached_property
    def scenario(self) -> Scenario | None:
        """The run's scenario, None for an imported log, and where the recorded one is invalid."""
        try:
            return override_resolved(self.recording.header.scenario, (), str(self.recording.path))
        except DynpfError:
            return None

    @cached_property
    def context(self) -> Context | None:
        """The context of the run's shared tables, with the files that they name; None where these are not to be had."""
        try:
            return Context(recorded_scenario(self.recording), "page")
        except DynpfError:
            return None

    @cached_property
    def origin_ns(self) -> int:
        """The logical time of the first message, ns."""
        return self.span_ns[0]

    @cached_property
    def span_ns(self) -> tuple[int, int]:
        """The logical times of the first and the last message, ns."""
        stamps = [record.stamp_ns for record in self.recording.messages()]
        return (min(stamps), max(stamps)) if stamps else (0, 0)

    def carrying(self, *kinds: type[Message]) -> list[str]:
        """Return the topics with messages of these types, in the order of the nodes that write them."""
        written = [topic for topics in self.recording.header.writes.values() for topic in topics]
        rank = {topic: number for number, topic in enumerate(written)}
        there = [topic for topic in self.recording.schemas if topic in self.recording.topics]
        found = [topic for topic in there if self.recording.topics[topic].type in kinds]
        return sorted(found, key=lambda topic: (rank.get(topic, len(rank)), topic))[:MOST_TOPICS]

    def records(self, topic: str) -> list[Recorded]:
        """Return the messages of a topic in order of time, undecoded."""
        if topic not in self._records:
            self._records[topic] = sorted(self.recording.messages(topic), key=lambda record: record.stamp_ns)
        return self._records[topic]

    def seconds(self, records: Sequence[Recorded]) -> FloatArray:
        """Return the times of messages, (T,)."""
        return np.array([(record.stamp_ns - self.origin_ns) * 1e-9 for record in records])

    def messages(self, topic: str, most: int | None = None) -> Iterator[tuple[float, Message]]:
        """Yield times and messages of a topic; if there are more than ``most``, so many of them at even distances."""
        if topic not in self.recording.schemas or topic not in self.recording.topics:
            return
        records = self.records(topic)
        if most is not None:
            records = [records[index] for index in evenly(len(records), most).tolist()]
        for record in records:
            message = self.decoded(record)
            if message is not None:
                yield (record.stamp_ns - self.origin_ns) * 1e-9, message

    def decoded(self, record: Recorded) -> Message | None:
        """Return a message, None where it does not decode."""
        try:
            return decode(record.topic, record.payload, self.recording.topics)
        except BadMessageError:
            self.unreadable += 1
            return None

    def ticks(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the times and numbers of the ticks, from the journal of the first node that has one; maybe none."""
        journals = self.recording.journals()
        first = next(iter(self.recording.header.writes), journals[0][0] if journals else "")
        entries = [
            (entry.stamp_ns, entry.tick)
            for node, boot in journals
            if node == first
            for entry in self.recording.journal(node, boot)
        ]
        stamps = np.array([(stamp - self.origin_ns) * 1e-9 for stamp, _ in entries])
        return stamps, np.array([tick for _, tick in entries], dtype=np.int64)


def robot_of(node: str) -> str:
    """Return the namespace of a node's robot, "" if it has none."""
    return node.rpartition("/")[0]
