"""What a capture holds and what it lacks: counts of each topic, and the account of each publisher's numbers.

Who records keeps it while messages are written; who reads a file makes it again from the messages in it.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from dynpf_formats.capture.form import LATEST_NS, Dropped, Ended, Loss, Origin, Outage
from dynpf_formats.capture.series import Series
from dynpf_formats.ros2.attachment import Lost
from dynpf_formats.ros2.keys import Published

__all__ = ["Sender", "Tally", "Topic"]

_LISTED_SENDERS, _LISTED_RANGES = 1000, 100


@dataclass
class Topic:
    """The messages of a topic: of which type, how many, how large, and when the first and the last arrived (ns)."""

    type: str
    messages: int = 0
    bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0
    unnumbered: int = 0
    faults: Counter[str] = field(default_factory=Counter)

    @property
    def rate_hz(self) -> float:
        """Messages a second, 0 if there are too few to tell."""
        span_ns = self.last_ns - self.first_ns
        return (self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0


class Sender(NamedTuple):
    """A publisher on a key, and what has come of it."""

    topic: str
    key: str
    publisher: str
    series: Series


class Tally:
    """Counts messages in the order of the file."""

    def __init__(self) -> None:
        self.topics: dict[str, Topic] = {}
        self.outages: list[Outage] = []
        self.dropped_unnumbered: Counter[str] = Counter()  # by key
        self._series: dict[tuple[str, str], Series] = {}
        self._topic_of: dict[str, str] = {}  # by key

    def add(self, origin: Origin, sequence: int, publish_ns: int, arrival_ns: int, size: int) -> Lost | None:
        """Count a message of ``size`` bytes; return the numbers missing before it, if it has a number."""
        topic = self.topics.get(origin.topic)
        if topic is None:
            topic = self.topics[origin.topic] = Topic(origin.type, first_ns=arrival_ns, last_ns=arrival_ns)
        if not origin.fault or origin.key not in self._topic_of:
            self._topic_of[origin.key] = origin.topic
        topic.messages += 1
        topic.bytes += size
        topic.first_ns = min(topic.first_ns, arrival_ns)
        topic.last_ns = max(topic.last_ns, arrival_ns)
        if origin.fault:
            topic.faults[origin.fault] += 1
        if not origin.publisher:
            topic.unnumbered += 1
            return None
        return self._of(origin.key, origin.publisher).see(sequence, publish_ns)

    def drop(self, dropped: Dropped) -> None:
        """Count messages that the recorder had no room for."""
        if not dropped.publisher:
            self.dropped_unnumbered[dropped.key] += dropped.count
        else:
            self._of(dropped.key, dropped.publisher).drop(dropped.first, dropped.last, dropped.stamp_ns)

    @property
    def senders(self) -> list[Sender]:
        """The publishers whose messages have numbers, by topic."""
        found = [Sender(self.topic_of(key), key, name, series) for (key, name), series in self._series.items()]
        return sorted(found, key=lambda sender: sender[:3])

    @property
    def messages(self) -> int:
        """Messages in the file."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def missing(self) -> int:
        """Messages that never came."""
        return sum(series.missing for series in self._series.values())

    @property
    def dropped(self) -> int:
        """Messages that came and that the recorder had no room for."""
        return sum(series.dropped for series in self._series.values()) + self.dropped_unnumbered.total()

    def ended(self, reason: str, ended_ns: int, *, complete: bool) -> Ended:
        """Return the end of a capture with these messages, which tells of the first thousand publishers with losses."""
        losses = [
            Loss(topic, name, one.missing, one.dropped, one.duplicates, one.late, one.lost[:_LISTED_RANGES])
            for topic, _, name, one in self.senders
            if one.missing or one.dropped or one.duplicates or one.late
        ]
        return Ended(
            reason=reason,
            complete=complete,
            ended_ns=min(ended_ns, LATEST_NS),
            messages=self.messages,
            missing=self.missing,
            dropped=self.dropped,
            outages=tuple(self.outages),
            losses=tuple(losses[:_LISTED_SENDERS]),
        )

    def topic_of(self, key: str) -> str:
        """Return the topic of a key: that of its messages, or of the ROS topic that it is."""
        if key in self._topic_of:
            return self._topic_of[key]
        published = Published.parse(key)
        return key if published is None else published.topic

    def _of(self, key: str, publisher: str) -> Series:
        series = self._series.get((key, publisher))
        if series is None:
            series = self._series[key, publisher] = Series()
        return series
