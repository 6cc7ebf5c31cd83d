from collections.abc import Sequence

from dynpf_protocol.codec import decode
from dynpf_protocol.messages import HostEvent
from dynpf_runtime.executor import Executor
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.inbox import Ready

from tests.unit.services.toy_nodes import ToyNode, executor_of, received

ODOMETRY = "sensors/odometry"


def seen(sequences: Sequence[int]) -> list[tuple[int, int]]:
    watch = GapWatch()
    events = [watch.see(ODOMETRY, "sensors", sequence) for sequence in sequences]
    return [(event.first, event.last) for event in events if event is not None]


def test_jumps_are_gaps() -> None:
    assert seen(range(5)) == []
    assert seen([2, 3, 7]) == [(0, 1), (4, 6)]


def test_what_comes_late_or_again_is_no_gap_and_fills_none() -> None:
    assert seen([0, 3, 1, 2, 4, 4, 6]) == [(1, 2), (5, 5)]


def test_each_sender_and_topic_has_its_own_sequence() -> None:
    watch = GapWatch()
    assert watch.see(ODOMETRY, "sensors", 0) is None
    assert watch.see("sensors/landmarks", "sensors", 0) is None
    assert watch.see("log", "vision", 0) is None
    assert watch.see("log", "estimator", 1) is not None


def notice(reads: set[str]) -> tuple[Executor, Ready, list[HostEvent]]:
    executor = executor_of(ToyNode("estimator", reads=reads), "boot", 1)
    ready = Ready(4, 40, [received(ODOMETRY, "sensors", sequence) for sequence in (1, 4)], False)
    sent = notice_gaps(executor, GapWatch(), ready, 40, 7)
    assert [(one.topic, one.envelope.sequence, one.envelope.tick) for one in sent] == [
        ("event/estimator", 0, 4),
        ("event/estimator", 1, 4),
    ]
    events = []
    for one in sent:
        event = decode(one.topic, one.payload)
        assert isinstance(event, HostEvent)
        events.append(event)
    return executor, ready, events


def test_gaps_are_told_and_a_node_that_asks_for_it_reads_of_them() -> None:
    told = [
        HostEvent(kind="gap", topic=ODOMETRY, node="sensors", first=first, last=last)
        for first, last in ((0, 0), (2, 3))
    ]
    _, ready, events = notice({ODOMETRY, "event/estimator"})
    assert events == told
    assert [one.message for one in ready.inputs[2:]] == told
    assert [(one.topic, one.node, one.boot, one.sequence, one.stamp_ns) for one in ready.inputs[2:]] == [
        ("event/estimator", "estimator", "boot", 0, 40),
        ("event/estimator", "estimator", "boot", 1, 40),
    ]
    _, ready, events = notice({ODOMETRY})
    assert events == told
    assert len(ready.inputs) == 2
