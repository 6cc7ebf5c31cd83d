"""A node that goes on from a snapshot does what it would have done: every kind, at any step, byte for byte."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import decode_entry, encode_entry
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX, unpack
from dynpf_runtime.executor import Sent
from dynpf_runtime.inline import BOOT, run_inline
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.seat import Made, Seat
from dynpf_runtime.source import Feed, feed_log, feed_ticks
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.kinds import node_kinds
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario
from dynpf_services.scenario.user_code import add_folders
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from tests.replay.laser_log import laser_log

EXAMPLES = Path(__file__).parents[2] / "examples"
LATE = "faults=[{topic='sensors/odometry', to='estimator', loss=0.1, delay_s=0.1, jitter_s=0.4}]"
CASES: dict[str, tuple[str, ...]] = {
    "landmark-filters": ("max_ticks=30",),
    "landmark-room": ("max_ticks=40", LATE),
    "room-scan": ("max_ticks=16",),
    "indoor-global": ("max_ticks=8",),
    "turtlebot-loops": ("max_ticks=20",),
    "parts-3-tracked": ("max_ticks=60",),
    "parts-3-lens": ("max_ticks=5",),
    "colon-case-5": ("max_ticks=11",),
    f"{EXAMPLES}/uwb/uwb.toml": ("max_ticks=30",),
    f"{EXAMPLES}/controller/controller.toml": ("max_ticks=30",),
    "laser-log": (),
}


class Step(NamedTuple):
    """What a step of a node sends, with its encoded journal entry."""

    sent: tuple[Sent, ...]
    entry: bytes

    @property
    def done(self) -> TickDone:
        entry = decode_entry(self.entry)
        topics = [message.topic for message in self.sent]
        counts = {topic: topics.count(topic) for topic in topics}
        return TickDone("", BOOT, entry.step, entry.tick, entry.stamp_ns, counts, entry.last)


class Kept:
    """Keeps all that a run would record, by node and tick."""

    messages = 0

    def __init__(self) -> None:
        self.steps: dict[str, list[Step]] = {}
        self.snapshots: list[Sent] = []
        self._sent: list[Sent] = []

    def message(self, topic: str, envelope: Envelope, payload: bytes) -> None:
        whole = Sent(topic, envelope, payload)
        (self.snapshots if topic.startswith(SNAPSHOT_PREFIX) else self._sent).append(whole)

    def journal(self, envelope: Envelope, payload: bytes) -> None:
        self.steps.setdefault(envelope.node, []).append(Step(tuple(self._sent), payload))
        self._sent = []


class Case(NamedTuple):
    """A run, and a snapshot of each node after each of its steps, as a recording would have it."""

    scenario: Scenario
    plan: Plan
    steps: dict[str, list[Step]]
    feeds: list[Feed]
    snapshots: dict[str, list[Snapshot]]


@cache
def case(name: str) -> Case:
    with TemporaryDirectory() as folder:
        log = laser_log(Path(folder)) if name == "laser-log" else None
    if Path(name).is_absolute():
        add_folders([Path(name).parent])
    scenario = load_scenario(name, overrides=CASES[name], log=log.facts if log else None)
    plan = plan_of(scenario)
    records = log.records if log else []
    kept = Kept()
    run_inline(plan, records, kept)
    feeds = [*feed_ticks(plan.tick_ns, plan.max_ticks)]
    if log:
        feeds = [*feed_log(records, plan.graph, boot=BOOT, publish_ns=0, max_ticks=plan.max_ticks)]
    made = Case(scenario, plan, kept.steps, feeds, {})
    for node in plan.graph.nodes:
        seat = Seat(plan.graph.specs[node], plan, BOOT)
        made.snapshots[node] = [recorded(node, seat, step) for step in going_on(made, node, seat, 0)]
    return made


def recorded(node: str, seat: Seat, made: Made) -> Snapshot:
    snapshot = seat.freeze(made.entry)
    assert snapshot is not None
    topic = SNAPSHOT_PREFIX + node
    read = decode(topic, encode(topic, snapshot, seat.topics), seat.topics)
    assert isinstance(read, Snapshot)
    return read


def going_on(case: Case, node: str, seat: Seat, first: int) -> Iterator[Made]:
    """Yield the steps of a node from the ``first`` on, which gets what the others have sent in the run."""
    graph = case.plan.graph
    for tick in range(first, len(case.steps[node])):
        for other, lag in graph.lags[node].items():
            if tick >= lag:
                step = case.steps[other][tick - lag]
                for message in step.sent:
                    if message.topic in seat.reads:
                        seat.inbox.deliver(received(message, seat), message.envelope.tick)
                seat.inbox.done(replace(step.done, node=other))
        if node == graph.source:
            feed = case.feeds[tick]
            ready = seat.take(feed.stamp_ns)
            ready = ready._replace(inputs=[*feed.inputs, *ready.inputs])
            yield seat.step(ready, feed.stamp_ns, feed.sent, last=feed.last)
        else:
            ready = seat.take()
            yield seat.step(ready, ready.stamp_ns, (), last=ready.last)


def received(message: Sent, seat: Seat) -> Received:
    envelope = message.envelope
    content = message.message(seat.topics)
    return Received(message.topic, envelope.node, envelope.boot, envelope.sequence, envelope.stamp_ns, content)


@pytest.mark.parametrize("name", CASES, ids=lambda name: Path(name).stem)
@settings(max_examples=12, deadline=None, derandomize=True)
@given(data=st.data())
def test_going_on_from_a_snapshot_is_going_on(name: str, data: st.DataObject) -> None:
    run = case(name)
    node = data.draw(st.sampled_from(run.plan.graph.nodes))
    steps = run.steps[node]
    step = data.draw(st.integers(0, len(steps) - 2))
    seat = Seat(run.plan.graph.specs[node], run.plan, BOOT)
    seat.thaw(run.snapshots[node][step])
    made = [Step(made.sent, encode_entry(made.entry)) for made in going_on(run, node, seat, step + 1)]
    assert made == steps[step + 1 :]


def test_every_kind_of_node_is_among_them() -> None:
    kinds = {kind for name in CASES for kind in case(name).scenario.kinds.values()}
    assert {*node_kinds(None).values()} <= kinds
    assert kinds - {*node_kinds(None).values()}, "nodes of a user's own are of none of these"


def test_what_a_link_holds_back_is_in_the_snapshot_and_without_it_the_node_does_something_else() -> None:
    run = case("landmark-room")
    held = [len(unpack(snapshot.state).inbox.held) for snapshot in run.snapshots["estimator"]]
    step = held.index(max(held))
    assert held[step] > 0
    seat = Seat(run.plan.graph.specs["estimator"], run.plan, BOOT)
    seat.thaw(run.snapshots["estimator"][step])
    seat.inbox.thaw(replace(unpack(run.snapshots["estimator"][step].state).inbox, held=()))
    made = [encode_entry(made.entry) for made in going_on(run, "estimator", seat, step + 1)]
    assert made != [one.entry for one in run.steps["estimator"][step + 1 :]]


def test_a_snapshot_of_another_node_is_refused_in_a_sentence() -> None:
    run = case("landmark-room")
    seat = Seat(run.plan.graph.specs["estimator"], run.plan, BOOT)
    with pytest.raises(BadMessageError, match="the snapshot after step 3 is none of estimator"):
        seat.thaw(run.snapshots["simulator"][3])
