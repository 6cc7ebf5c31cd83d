"""Inboxes: what a node is given must not depend on the network (lockstep), or is what has come (realtime)."""

from collections import Counter
from collections.abc import Iterable, Sequence

import pytest
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import OrderError
from dynpf_runtime.faults import Fault, FaultyLink
from dynpf_runtime.inbox import LockstepInbox, Ready, RealtimeInbox
from dynpf_runtime.node import Received
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.services.toy_nodes import ToyNode, graph_of, received

TICK_NS = 100_000_000
ANY_ORDER = settings(derandomize=True, deadline=None, max_examples=60)
READS = frozenset({"sensors/odometry", "sensors/landmarks", "vision/detections", "controller/command"})
WRITERS = {
    "vision": ("vision/detections",),
    "sensors": ("sensors/odometry", "sensors/landmarks", "sensors/gripper"),  # the last is not read
    "controller": ("controller/command",),
}
GRAPH = graph_of(
    [
        ToyNode("simulator", reads=["controller/command"], writes=["truth/robot", "camera/image"]),
        ToyNode("vision", reads=["camera/image"], writes=WRITERS["vision"]),
        ToyNode("sensors", reads=["truth/robot"], writes=[*WRITERS["sensors"], "sensors/scan"]),
        ToyNode("estimator", reads=READS, writes=["estimator/state"]),
        ToyNode("controller", reads=["estimator/state"], writes=WRITERS["controller"]),
    ]
)

Arrival = tuple[Received, int] | TickDone
"""A message with its tick, or the end of a tick."""


def inbox(*faults: Fault, seed: int = 1) -> LockstepInbox:
    return LockstepInbox(GRAPH, "estimator", FaultyLink(faults, "estimator", seed))


def traffic(counts: Sequence[dict[str, int]]) -> dict[str, list[Arrival]]:
    """Return what each sender sends: ``counts[tick][topic]`` messages, and the end of each tick."""
    sequences: Counter[str] = Counter()
    sent: dict[str, list[Arrival]] = {node: [] for node in WRITERS}
    for tick, of_topic in enumerate(counts):
        last = tick + 1 == len(counts)
        for node, topics in WRITERS.items():
            for topic in topics:
                for _ in range(of_topic.get(topic, 0)):
                    if topic in READS:
                        sent[node].append((received(topic, node, sequences[topic], tick * TICK_NS), tick))
                    sequences[topic] += 1
            told = {topic: of_topic[topic] for topic in topics if of_topic.get(topic)}
            sent[node].append(TickDone(node, "b", tick, tick, tick * TICK_NS, told, last))
    return sent


def run(box: LockstepInbox, arrivals: Iterable[Arrival]) -> list[Ready]:
    steps = []
    for one in arrivals:
        if isinstance(one, TickDone):
            box.done(one)
        else:
            box.deliver(*one)
        while (ready := box.take()) is not None:
            steps.append(ready)
    return steps


counts_of_ticks = st.lists(
    st.fixed_dictionaries({topic: st.integers(0, 2) for topics in WRITERS.values() for topic in topics}),
    min_size=1,
    max_size=4,
)


def expected(counts: Sequence[dict[str, int]]) -> list[Ready]:
    """Return the steps by definition: this tick's from before, the last tick's from behind, in the order of inputs."""
    messages = [one for sent in traffic(counts).values() for one in sent if not isinstance(one, TickDone)]
    return [
        Ready(
            tick,
            tick * TICK_NS,
            sorted(
                (one for one, at in messages if at == tick - (one.node == "controller")),
                key=lambda one: GRAPH.input_order(one.topic, one.node, one.sequence),
            ),
            tick + 1 == len(counts),
        )
        for tick in range(len(counts))
    ]


@ANY_ORDER
@given(counts=counts_of_ticks, data=st.data())
def test_any_order_of_arrival_gives_the_same_steps(counts: list[dict[str, int]], data: st.DataObject) -> None:
    arrivals = data.draw(st.permutations([one for sent in traffic(counts).values() for one in sent]))
    assert run(inbox(), arrivals) == expected(counts)


@ANY_ORDER
@given(counts=counts_of_ticks, data=st.data())
def test_it_never_steps_before_all_is_there(counts: list[dict[str, int]], data: st.DataObject) -> None:
    arrivals = data.draw(st.permutations([one for sent in traffic(counts).values() for one in sent]))
    held_back = data.draw(st.integers(0, len(arrivals) - 1))
    held = arrivals[held_back]
    tick = held.tick if isinstance(held, TickDone) else held[1]
    node = held.node if isinstance(held, TickDone) else held[0].node
    box = inbox()
    steps = run(box, [one for place, one in enumerate(arrivals) if place != held_back])
    assert steps == expected(counts)[: tick + (node == "controller")]
    assert steps + run(box, [arrivals[held_back]]) == expected(counts)


@pytest.mark.parametrize("early", [True, False])
def test_a_message_of_refused_content_stalls_nobody(early: bool) -> None:
    refused = "sensors/odometry", "sensors", Envelope("sensors", "b", 0, 0, 0, 0)
    (_, other, done), vision, controller = (
        traffic([{"sensors/odometry": 1, "sensors/landmarks": 1}])[node] for node in ("sensors", "vision", "controller")
    )
    box = inbox()
    assert run(box, [*vision, *controller]) == []
    if early:
        box.deliver_refused(*refused)
    assert run(box, [other]) == []
    steps = run(box, [done])
    if not early:
        assert steps == []
        box.deliver_refused(*refused)
        steps = run(box, [])
        ready = box.take()
        steps = [ready] if ready else []
    assert [[one.topic for one in ready.inputs] for ready in steps] == [["sensors/landmarks"]]


def admitted(box: LockstepInbox | RealtimeInbox, name: str, sequence: int, tick: int) -> bool:
    try:
        box.admit(name, name.partition("/")[0], Envelope("x", "b", sequence, tick, 0, 0))
    except OrderError:
        return False
    return True


def test_in_lockstep_only_what_a_node_sends_in_its_tick_is_admitted() -> None:
    box = inbox()
    sent = traffic([{"sensors/odometry": 2, "controller/command": 1}] * 2)
    assert [admitted(box, "sensors/odometry", 0, tick) for tick in (0, 1, 10**6)] == [True, False, False]
    assert [admitted(box, "sensors/odometry", sequence, 0) for sequence in (1, 10**6, 2**32 - 1)] == [
        True,
        False,
        False,
    ]
    run(box, [sent["sensors"][0]])
    assert not admitted(box, "sensors/odometry", 0, 0)  # it has come
    run(box, sent["sensors"][1:3])
    assert [admitted(box, "sensors/odometry", 2, tick) for tick in (0, 1)] == [True, False]
    with pytest.raises(OrderError, match="the end of tick 0 again"):
        box.admit_end(sent["sensors"][2])  # type: ignore[arg-type]
    steps = run(box, [*sent["vision"][:1], *sent["controller"][:1]])
    assert len(steps) == 1
    assert [admitted(box, "sensors/odometry", *place) for place in ((0, 0), (2, 0), (0, 1), (2, 1))] == [
        False,
        False,
        False,
        True,
    ]


@pytest.mark.parametrize("sequence", [1, 2, 7])
def test_what_the_end_of_the_tick_does_not_promise_is_dropped_and_the_true_one_taken(sequence: int) -> None:
    counts = [{"sensors/odometry": 1}] * 3
    forged = received("sensors/odometry", "sensors", sequence, 10**9)
    arrivals = [one for sent in traffic(counts).values() for one in sent]
    assert run(inbox(), [(forged, 0), *arrivals]) == expected(counts)


def test_an_end_that_promises_what_never_comes_stalls_nobody() -> None:
    counts = [{"sensors/odometry": 1}] * 2
    forged = [TickDone("sensors", "b", 0, 0, 0, {"sensors/odometry": number + 2}, True) for number in range(100)]
    assert run(inbox(), [*forged, *(one for sent in traffic(counts).values() for one in sent)]) == expected(counts)


def test_in_realtime_a_number_far_ahead_is_refused_and_one_ahead_does_not_close_those_before_it() -> None:
    box = realtime()
    assert [admitted(box, "sensors/odometry", sequence, 0) for sequence in (0, 10**6, 500, 1, 2, 2, 0, 500, 501)] == [
        True,
        False,
        True,
        True,
        True,
        False,
        False,
        False,
        True,
    ]


def test_the_source_sets_the_time_and_waits_for_the_end_of_the_round() -> None:
    box = LockstepInbox(GRAPH, "simulator", FaultyLink((), "simulator", 1))
    assert box.take(7) == Ready(0, 7, [], False)
    command = received("controller/command", "controller", 0, 7)
    box.deliver(command, 0)
    for node in ("sensors", "vision", "estimator", "controller"):
        assert box.take(9) is None
        box.done(TickDone(node, "b", 0, 0, 7, {"controller/command": 1} if node == "controller" else {}, False))
    assert box.take(9) == Ready(1, 9, [command], False)


def test_lost_messages_are_missing_and_nobody_waits_for_them() -> None:
    counts = [{"sensors/odometry": 2, "sensors/landmarks": 1}] * 3
    arrivals = [one for sent in traffic(counts).values() for one in sent]
    steps = run(inbox(Fault(topic="sensors/odometry", to="estimator", loss=1.0)), arrivals)
    assert [[one.topic for one in ready.inputs] for ready in steps] == [["sensors/landmarks"]] * 3


@pytest.mark.parametrize(("delay_s", "late"), [(0.0, 0), (0.1, 1), (0.15, 2), (0.2, 2)])
def test_delayed_messages_come_in_logical_time(delay_s: float, late: int) -> None:
    counts = [{"sensors/odometry": 1, "sensors/landmarks": 1}] * 5
    arrivals = [one for sent in traffic(counts).values() for one in sent]
    steps = run(inbox(Fault(topic="sensors/odometry", to="estimator", delay_s=delay_s)), arrivals)
    came = [[one.sequence for one in ready.inputs if one.topic == "sensors/odometry"] for ready in steps]
    assert came == [[]] * late + [[tick] for tick in range(5 - late)]
    assert all(sum(one.topic == "sensors/landmarks" for one in ready.inputs) == 1 for ready in steps)


def test_what_the_source_reads_is_delayed_too() -> None:
    fault = Fault(topic="controller/command", to="simulator", delay_s=0.25)
    box = LockstepInbox(GRAPH, "simulator", FaultyLink((fault,), "simulator", 1))
    came = []
    for tick in range(5):
        ready = box.take(tick * TICK_NS)
        assert ready is not None
        came.append([one.sequence for one in ready.inputs])
        box.deliver(received("controller/command", "controller", tick, tick * TICK_NS), tick)
        for node in GRAPH.nodes[1:]:
            counts = {"controller/command": 1} if node == "controller" else {}
            box.done(TickDone(node, "b", tick, tick, tick * TICK_NS, counts, False))
    assert came == [[], [], [], [0], [1]]


@ANY_ORDER
@given(counts=counts_of_ticks, data=st.data())
def test_faults_do_not_depend_on_the_order_of_arrival(counts: list[dict[str, int]], data: st.DataObject) -> None:
    faults = (
        Fault(topic="sensors/odometry", to="estimator", loss=0.3, delay_s=0.05, jitter_s=0.3),
        Fault(topic="vision/detections", to="estimator", jitter_s=0.2),
    )
    arrivals = [one for sent in traffic(counts).values() for one in sent]
    assert run(inbox(*faults), data.draw(st.permutations(arrivals))) == run(inbox(*faults), arrivals)


def realtime(*faults: Fault) -> RealtimeInbox:
    return RealtimeInbox(GRAPH, "estimator", FaultyLink(faults, "estimator", 1))


def sequences(ready: Ready | None) -> list[tuple[str, int]] | None:
    return None if ready is None else [(one.topic.partition("/")[2], one.sequence) for one in ready.inputs]


def test_realtime_gives_what_has_come_in_order_of_arrival_when_something_triggers() -> None:
    box = realtime()
    for sequence in (3, 1):
        box.deliver(received("controller/command", "controller", sequence, 50), 0, 10)
        assert box.take(10) is None  # a command alone wakes no estimator
    box.deliver(received("sensors/odometry", "sensors", 0, 40), 0, 11)
    ready = box.take(11)
    assert sequences(ready) == [("command", 3), ("command", 1), ("odometry", 0)]
    assert box.take(12) is None
    assert ready is not None
    assert (ready.tick, ready.stamp_ns, ready.last) == (0, 50, False)


def test_after_an_absence_a_realtime_inbox_takes_what_comes_next_whatever_was_missed() -> None:
    box = realtime()
    assert admitted(box, "sensors/odometry", 0, 0)
    assert not admitted(box, "sensors/odometry", 5000, 0)  # a stranger's, who knows of no absence
    with pytest.raises(OrderError):
        box.admit_end(TickDone("sensors", "b", 700, 700, 0, {}, last=True))
    box.missed()
    assert [admitted(box, "sensors/odometry", number, 0) for number in (5000, 4999, 5001, 9000)] == [True] * 3 + [False]
    assert admitted(box, "controller/command", 7000, 0)  # of which nothing had come
    box.admit_end(TickDone("sensors", "b", 700, 700, 0, {}, last=True))
    for tick in (700, 702):
        with pytest.raises(OrderError, match="expected that of 701"):
            box.admit_end(TickDone("sensors", "b", tick, tick, 0, {}, last=True))


def test_realtime_keeps_all_of_a_reliable_topic_and_the_newest_of_a_fresh_one() -> None:
    box = realtime()
    for sequence in range(3):
        box.deliver(received("sensors/scan", "sensors", sequence), 0, 10)
        box.deliver(received("sensors/odometry", "sensors", sequence), 0, 10)
    assert sequences(box.take(10)) == [("odometry", 0), ("odometry", 1), ("scan", 2), ("odometry", 2)]


def test_realtime_delays_run_on_the_wall_clock_and_the_lost_never_come() -> None:
    box = realtime(
        Fault(topic="sensors/odometry", to="estimator", delay_s=1e-6),
        Fault(topic="vision/detections", to="estimator", loss=1.0),
    )
    assert box.due_ns() is None
    box.deliver(received("sensors/odometry", "sensors", 0), 0, 100)
    box.deliver(received("sensors/landmarks", "sensors", 0), 0, 100)
    box.deliver(received("vision/detections", "vision", 0), 0, 100)
    assert sequences(box.take(100)) == [("landmarks", 0)]
    assert box.due_ns() == 1100
    assert box.take(1099) is None
    assert sequences(box.take(1100)) == [("odometry", 0)]
    assert box.due_ns() is None


@ANY_ORDER
@given(stamps=st.lists(st.integers(0, 10), min_size=1, max_size=12))
def test_realtime_stamps_never_go_back(stamps: list[int]) -> None:
    box = realtime()
    taken = []
    for sequence, stamp in enumerate(stamps):
        box.deliver(received("sensors/odometry", "sensors", sequence, stamp), 0, 0)
        ready = box.take(0)
        assert ready is not None
        taken.append((ready.tick, ready.stamp_ns))
    assert taken == [(tick, max(stamps[: tick + 1])) for tick in range(len(stamps))]


def test_realtime_ends_when_all_whose_output_it_needs_have_ended() -> None:
    box = realtime()
    for node in ("controller", "sensors"):
        box.done(TickDone(node, "b", 4, 4, 0, {}, True))
        assert not box.upstream_ended
    box.done(TickDone("vision", "b", 4, 4, 0, {}, False))
    assert not box.upstream_ended
    assert not box.take_all(0).last
    box.done(TickDone("vision", "b", 5, 5, 0, {}, True))
    assert box.upstream_ended
    box.deliver(received("controller/command", "controller", 0), 0, 0)
    ready = box.take_all(0)
    assert (sequences(ready), ready.last) == ([("command", 0)], True)
