"""The messages of a run for measures, from a recording or from an observed run."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import Message, Pose, heading
from dynpf_runtime.node import Received
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import override_resolved
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.schema import Scenario
from numpy.typing import NDArray

__all__ = ["Observed", "RunMessages", "Timed", "of_type", "planar_poses", "recorded", "seconds"]

MessageT = TypeVar("MessageT", bound=Message)


class Timed(NamedTuple):
    """A message, its logical time in nanoseconds, and its number among all messages of the run."""

    stamp_ns: int
    number: int
    message: Message


class RunMessages:
    """A run's scenario and its messages by topic; each topic is read once, at its first use.

    ``scenario`` may lack the content of the files that it names; ``with_files`` returns the scenario with it.
    ``topics`` are the topics with messages and their types, in the order of the nodes that write them.
    """

    def __init__(
        self,
        scenario: Callable[[], Scenario],
        with_files: Callable[[], Scenario],
        read: Callable[[str], Iterable[Timed]],
        topics: Mapping[str, type[Message]],
    ) -> None:
        self._scenario, self.with_files, self._read, self.topics = scenario, with_files, read, topics
        self._known: dict[str, list[Timed]] = {}

    @cached_property
    def scenario(self) -> Scenario:
        """The run's scenario; raises ScenarioError where a recording's scenario is invalid."""
        return self._scenario()

    def topic(self, name: str) -> list[Timed]:
        """Return the messages of a topic in order of time."""
        if name not in self._known:
            self._known[name] = sorted(self._read(name), key=lambda timed: timed.stamp_ns)
        return self._known[name]

    def carrying(self, kind: type[Message]) -> list[str]:
        """Return the topics whose messages are of a type."""
        return [name for name, known in self.topics.items() if known is kind]


class Observed:
    """An observer of ``run_inline`` that keeps the messages of some topics."""

    def __init__(self, topics: Iterable[str]) -> None:
        self._topics = frozenset(topics)
        self._kept: defaultdict[str, list[Timed]] = defaultdict(list)
        self._number = 0

    def __call__(self, received: Received) -> None:
        if received.topic in self._topics:
            self._kept[received.topic].append(Timed(received.stamp_ns, self._number, received.message))
        self._number += 1

    def run_of(self, scenario: Scenario) -> RunMessages:
        """Return the kept messages of a run of ``scenario``; raises KeyError for a topic that was not observed."""
        rows = plan_of(scenario).graph.topics

        def read(name: str) -> list[Timed]:
            """Yield the messages of a topic."""
            if name in rows and name not in self._topics:
                raise KeyError(f"{name} was not observed; observed are {', '.join(sorted(self._topics))}")
            return self._kept[name]

        topics = {name: row.type for name, row in rows.items() if self._kept[name]}
        return RunMessages(lambda: scenario, lambda: scenario, read, topics)


def recorded(recording: Recording) -> RunMessages:
    """Return the messages of a recording; those of a topic are decoded at its first use."""

    def scenario() -> Scenario:
        """Return the scenario that the recording holds, with the code and files that it names left alone."""
        return override_resolved(recording.header.scenario, (), str(recording.path))

    def read(name: str) -> Iterable[Timed]:
        """Yield the messages of a topic."""
        for number, record in enumerate(recording.messages()):
            if record.topic == name:
                yield Timed(record.stamp_ns, number, decode(name, record.payload, recording.topics))

    written = [topic for topics in recording.header.writes.values() for topic in topics]
    rank = {topic: number for number, topic in enumerate(written)}
    there = sorted({*recording.schemas} & {*recording.topics}, key=lambda name: rank.get(name, len(rank)))
    topics = {name: recording.topics[name].type for name in there}
    return RunMessages(scenario, lambda: recorded_scenario(recording), read, topics)


def of_type(messages: Sequence[Timed], kind: type[MessageT]) -> list[MessageT]:
    """Return the messages, which must all be of type ``kind``, without their times."""
    found = [timed.message for timed in messages if isinstance(timed.message, kind)]
    assert len(found) == len(messages)
    return found


def planar_poses(poses: Iterable[Pose]) -> NDArray[np.float64]:
    """Return poses in the plane as x, y (m) and theta (rad), (3, T)."""
    return np.array([(pose.position.x, pose.position.y, heading(pose.orientation)) for pose in poses]).reshape(-1, 3).T


def seconds(messages: Sequence[Timed]) -> NDArray[np.float64]:
    """Return the logical times in seconds, (T,)."""
    return np.array([timed.stamp_ns * 1e-9 for timed in messages])
