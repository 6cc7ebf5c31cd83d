"""A twin that follows a run: it executes all of it again, finds one changed byte, and begins late with a snapshot."""

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

import pytest
from dynpf_formats.recording.reader import Recorded, Recording, read_recording
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.keys import JOURNAL, data_key
from dynpf_runtime.follow import Follower
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.plan import Plan
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

TICKS = 300
NODES = 4


class Run(NamedTuple):
    plan: Plan
    recording: Recording
    heard: tuple[Arrived, ...]  # in the order of the run


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    path: Path = tmp_path_factory.mktemp("run") / "run.mcap"
    scenario = load_scenario("landmark-room", overrides=[f"max_ticks={TICKS}"], seed=1)
    record_inline(scenario, path)
    recording = read_recording(path)
    return Run(plan_of(scenario), recording, tuple(map(arrived, recording.records)))


def arrived(record: Recorded) -> Arrived:
    node = record.node
    key = JOURNAL + node if record.topic == JOURNAL_PREFIX + node else data_key(record.topic, node)
    envelope = Envelope(node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
    return Arrived(key, record.payload, encode_envelope(envelope))


def follow(plan: Plan, heard: Iterable[Arrived]) -> Follower:
    follower = Follower(plan)
    for one in heard:
        follower.hear(one)
        if one.key.startswith(JOURNAL):
            follower.advance()
    follower.advance()
    return follower


def steps(follower: Follower) -> list[int]:
    return [twin.steps for twin in follower.twins.values()]


def place(run: Run, topic: str, sequence: int) -> int:
    """Return the place of a message among what is heard."""
    found = [index for index, one in enumerate(run.recording.records) if (one.topic, one.sequence) == (topic, sequence)]
    return found[0]


def mixed(run: Run, count: int) -> Iterator[Arrived]:
    """Yield the first messages of a run as a network may bring them: in the order of each sender, else in any."""
    senders: dict[str, deque[Arrived]] = {}
    for record, one in zip(run.recording.records, run.heard[:count], strict=False):
        senders.setdefault(record.node, deque()).append(one)
    random = Random(1)
    while left := [queue for queue in senders.values() if queue]:
        yield random.choice(left).popleft()


def with_a_byte_changed(run: Run, topic: str, sequence: int, old: bytes, new: bytes) -> list[Arrived]:
    index = place(run, topic, sequence)
    changed = list(run.heard)
    assert old in changed[index].payload
    changed[index] = changed[index]._replace(payload=changed[index].payload.replace(old, new, 1))
    return changed


def test_a_whole_run_is_the_same_in_whatever_order_its_messages_arrive_and_repeated(run):
    follower = follow(run.plan, run.heard)
    assert (follower.first, follower.refused) == (None, 0)
    assert steps(follower) == [TICKS] * NODES
    assert [twin.begun for twin in follower.twins.values()] == [[0]] * NODES
    recorded = [one for one in run.recording.records if not one.topic.startswith(("journal/", "snapshot/"))]
    assert sum(twin.messages for twin in follower.twins.values()) == len(recorded)

    disordered = follow(run.plan, [*mixed(run, 2000), *run.heard[:500]])
    assert disordered.first is None
    assert steps(disordered) == steps(follow(run.plan, run.heard[:2000]))
    assert min(steps(disordered)) > 100


def test_one_changed_byte_of_an_output_is_found_where_it_is(run):
    heard = with_a_byte_changed(run, "estimator/state", 40, b'"n_eff":', b'"n_efg":')
    found = follow(run.plan, heard).first
    assert found is not None
    mismatch = found.mismatch
    assert (mismatch.node, mismatch.tick, mismatch.topic, mismatch.sequence) == ("estimator", 40, "estimator/state", 40)
    original = run.heard[place(run, "estimator/state", 40)].payload
    assert found.offset == original.index(b'"n_eff"') + len('"n_ef')


def test_the_node_that_diverged_is_told_and_not_those_that_it_led_astray(run):
    heard = with_a_byte_changed(run, "sensors/odometry", 40, b'"v":', b'"v":1')
    follower = follow(run.plan, heard)
    assert follower.first is not None
    assert follower.first.mismatch[:4] == ("sensors", "sensors/odometry", 40, 40)
    assert follower.twins["estimator"].divergence is not None, "it was given what the run's estimator was not"
    # The rest of the run changes nothing of it; before the others have come so far it is not settled.
    assert follower.settled
    behind = [one for index, one in enumerate(heard) if one.key != f"{JOURNAL}simulator" or index < 400]
    early = follow(run.plan, behind)
    assert early.first == follower.first
    assert early.twins["simulator"].steps < 40
    assert not early.settled


def test_a_twin_that_joins_late_begins_with_a_snapshot_and_checks_from_there_on(run):
    begin = place(run, "truth/robot", 20)
    late = follow(run.plan, run.heard[begin:])
    assert (late.first, late.refused) == (None, 0)
    begun = {name: twin.begun for name, twin in late.twins.items()}
    assert all(len(where) == 1 and where[0] > 20 for where in begun.values()), begun
    assert [twin.begun[0] + twin.steps for twin in late.twins.values()] == [TICKS] * NODES

    by_no_snapshot = Follower(run.plan, by_snapshots=False)
    for one in run.heard[begin:]:
        by_no_snapshot.hear(one)
    assert by_no_snapshot.advance() == 0

    (from_step,) = begun["estimator"]
    for step, is_checked in ((from_step - 1, False), (from_step + 5, True)):
        heard = with_a_byte_changed(run, "estimator/state", step, b'"n_eff":', b'"n_efg":')
        found = follow(run.plan, heard[begin:]).first
        assert (found is not None and found.mismatch.tick == step) == is_checked


def test_a_message_that_never_came_holds_its_readers_up_and_no_one_else(run):
    lost = place(run, "sensors/odometry", 150)
    follower = follow(run.plan, [*run.heard[:lost], *run.heard[lost + 1 :]])
    assert follower.first is None
    assert {name: twin.pending for name, twin in follower.twins.items()} == {
        "simulator": 0,
        "sensors": TICKS - 150,
        "estimator": TICKS - 150,
        "controller": 0,
    }


def test_what_cannot_be_read_is_counted_and_harms_nothing(run):
    index = place(run, "journal/estimator", 3)
    envelope, own = (encode_envelope(Envelope(node, "b", 0, 0, 0, 0)) for node in ("nobody", "estimator"))
    noise = [
        Arrived(f"{JOURNAL}estimator", b"{", run.heard[index].attachment),
        Arrived(f"{JOURNAL}estimator", run.heard[index].payload, envelope),
        Arrived(f"{JOURNAL}nobody", run.heard[index].payload, envelope),
        Arrived(data_key("estimator/state", "estimator"), b"{}", b"\xff"),
        Arrived(data_key("snapshot/estimator", "estimator"), b"{}", own),
    ]
    follower = follow(run.plan, [*noise, *run.heard])
    assert follower.refused == len(noise)
    assert follower.first is None
    assert steps(follower) == [TICKS] * NODES
