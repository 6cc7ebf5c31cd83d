"""Snapshots: when they are taken, what a realtime host keeps in them, and that only what agrees is used."""

from pathlib import Path

import msgspec
import pytest
import zstandard
from dynpf_formats.recording.doctor import examine
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.recover import recover
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError, OrderError
from dynpf_protocol.messages import Log, LogLevel, Snapshot, timestamp
from dynpf_protocol.snapshots import MOST_STATE, FrozenInbox, pack, unpack
from dynpf_runtime.faults import Fault, FaultyLink
from dynpf_runtime.inbox import RealtimeInbox
from dynpf_runtime.inline import run_inline
from dynpf_runtime.node import Result, Step, decode_state
from dynpf_runtime.plan import Plan, run_header
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

from tests.unit.services.toy_nodes import ToyNode, graph_of, received, says

TOPIC = "snapshot/simulator"


def chatty(step: Step) -> Result:
    text = Log(timestamp=timestamp(0), level=LogLevel.INFO, message="x" * 1000, name="simulator")
    return says("log", text)


def plan(ticks: int, act=lambda _: Result()) -> Plan:
    simulator = ToyNode("simulator", writes=["log"], act=act)
    settings = [f"max_ticks={ticks}", "state_digest_ticks=10"]
    return plan_of(load_scenario("landmark-room", overrides=settings))._replace(graph=graph_of([simulator]))


def run(path: Path, plan: Plan) -> Path:
    with RecordingWriter(path, run_header(plan), topics=plan.graph.topics) as writer:
        run_inline(plan, [], writer)
        writer.close(complete=True, reason="finished", outcome="budget spent")
    return path


def snapshots(path: Path) -> list[Snapshot]:
    found = [decode(TOPIC, record.payload) for record in read_recording(path).messages(TOPIC)]
    return [one for one in found if isinstance(one, Snapshot)]


def test_the_more_a_node_says_the_more_often_its_state_is_kept_and_never_at_the_end(tmp_path: Path) -> None:
    told = snapshots(run(tmp_path / "chatty.mcap", plan(400, chatty)))
    assert [one.step for one in told] == [29, 129, 229, 329]  # the first one soon: a recorder has to keep all before
    assert [decode_state(unpack(one.state).state)["steps"] for one in told] == [30, 130, 230, 330]
    assert [unpack(one.state).sequences for one in told] == [
        {"log": one.step + 1, TOPIC: number} for number, one in enumerate(told, start=1)
    ]
    silent = snapshots(run(tmp_path / "silent.mcap", plan(600)))
    assert [one.step for one in silent] == [139, 409]  # by their journal entries alone
    undigested = snapshots(run(tmp_path / "undigested.mcap", plan(2100)._replace(state_digest_ticks=5000)))
    assert [one.step for one in undigested] == [1999]


def test_the_same_run_has_the_same_snapshots(tmp_path: Path) -> None:
    first, again = (snapshots(run(tmp_path / name, plan(150, chatty))) for name in ("first.mcap", "again.mcap"))
    assert first == again
    assert len(first) == 2


def test_a_state_that_is_too_large_to_be_read_again_has_no_snapshot(tmp_path: Path) -> None:
    whole = plan(105, chatty)._replace(state_digest_ticks=100)
    node = whole.graph.specs["simulator"].build()
    node.freeze = lambda: {"large": bytes(MOST_STATE)}  # type: ignore[method-assign]
    assert snapshots(run(tmp_path / "run.mcap", whole)) == []


def test_doctor_tells_a_snapshot_of_another_state_and_a_mended_file_keeps_the_true_ones(tmp_path: Path) -> None:
    path = run(tmp_path / "run.mcap", plan(250, chatty))
    assert examine(path) == []
    recover(path, tmp_path / "mended.mcap")
    assert snapshots(tmp_path / "mended.mcap") == snapshots(path)
    recording = read_recording(path)
    with RecordingWriter(tmp_path / "forged.mcap", recording.header, topics=recording.topics) as writer:
        for record in recording.records:
            payload = forged(record.payload) if record.topic == TOPIC else record.payload
            envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
            writer.message(record.topic, envelope, payload)
        writer.close(complete=True, reason="finished", outcome="budget spent")
    found = examine(tmp_path / "forged.mcap")
    assert {(one.severity, one.where) for one in found} == {("warning", TOPIC)}
    assert (
        "after step 29 is not of the state, or the chain value, that the journal has; it is not used" in found[0].what
    )


def forged(payload: bytes) -> bytes:
    snapshot = decode(TOPIC, payload)
    assert isinstance(snapshot, Snapshot)
    frozen = unpack(snapshot.state)
    packed = pack(msgspec.structs.replace(frozen, state=frozen.state + b"\x00"))
    assert packed is not None
    return encode(TOPIC, msgspec.structs.replace(snapshot, state=packed))


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "an unreadable snapshot"),
        (b"no such thing at all", "an unreadable snapshot"),
        (zstandard.ZstdCompressor().compress(b"\xc1" * 100), "an unreadable snapshot"),
        (zstandard.ZstdCompressor().compress(bytes(MOST_STATE + 1)), "claims 67108865 bytes uncompressed"),
        (zstandard.ZstdCompressor(write_content_size=False).compress(b"\x80"), "claims [0-9]+ bytes uncompressed"),
    ],
)
def test_what_is_no_snapshot_is_refused_before_it_is_unpacked(data: bytes, told: str) -> None:
    with pytest.raises(BadMessageError, match=told):
        unpack(data)


def realtime() -> RealtimeInbox:
    nodes = [ToyNode("sensors", writes=["sensors/odometry"]), ToyNode("estimator", reads=["sensors/odometry"])]
    fault = Fault(topic="sensors/odometry", to="estimator", delay_s=0.001)
    return RealtimeInbox(graph_of(nodes), "estimator", FaultyLink([fault], "estimator", 1))


def test_a_realtime_inbox_goes_on_by_the_clock_of_its_new_process() -> None:
    inbox = realtime()
    for sequence in (0, 2):
        one = received("sensors/odometry", "sensors", sequence, 5)
        inbox.admit(one.topic, "sensors", Envelope("sensors", "b", sequence, 0, 5, 0))
        inbox.deliver(one, 0, 100 * sequence)
    inbox.admit_end(TickDone("sensors", "b", 0, 0, 5, {}, False))
    assert [one.sequence for one in (inbox.take(1_000_000) or pytest.fail("nothing is due")).inputs] == [0]
    frozen = msgspec.msgpack.decode(msgspec.msgpack.encode(inbox.freeze(1_000_050)), type=FrozenInbox)

    again = realtime()
    again.thaw(frozen, 7_000_000)
    assert again.due_ns() == 7_000_150
    assert again.take(7_000_149) is None
    ready = again.take(7_000_150)
    assert ready is not None
    assert ([one.sequence for one in ready.inputs], ready.tick, ready.stamp_ns) == ([2], 1, 5)
    for sequence in (0, 2):
        with pytest.raises(OrderError, match="again"):
            again.admit("sensors/odometry", "sensors", Envelope("sensors", "b", sequence, 0, 5, 0))
    again.admit("sensors/odometry", "sensors", Envelope("sensors", "b", 1, 0, 5, 0))
    with pytest.raises(OrderError, match="expected that of 1"):
        again.admit_end(TickDone("sensors", "b", 0, 0, 5, {}, False))
    assert not again.upstream_ended
