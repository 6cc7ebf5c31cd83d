"""The recorder's window by itself: which snapshots count, of those that a peer may offer."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from dynpf_formats.recording.reader import Recorded, Recording, read_recording
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry
from dynpf_protocol.restoring import decode_snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_runtime import snapshot
from dynpf_runtime.machines.effects import Record
from dynpf_runtime.machines.window import Window
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=12", "estimator.n=10", "state_digest_ticks=2"])
GRAPH = plan_of(SCENARIO).graph
NODE = "estimator"


@pytest.fixture(name="run", scope="module")
def run_with_snapshots_at_every_step(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    path: Path = tmp_path_factory.mktemp("run") / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(snapshot, "_OFTEN", 1)
        patch.setattr(snapshot, "_SENT_PER_BYTE", 0)
        patch.setattr(snapshot, "_FIRST_SENT_PER_BYTE", 0)
        record_inline(SCENARIO, path)
    yield read_recording(path)


def of(run: Recording, topic: str) -> list[Recorded]:
    return [record for record in run.messages() if record.topic == topic]


def filled(run: Recording) -> Window:
    """Return the window of a run all of whose steps are written."""
    window = Window(GRAPH)
    for name in GRAPH.nodes:
        for record in (record for record in run.records if record.topic == JOURNAL_PREFIX + name):
            entry = decode_entry(record.payload)
            envelope = Envelope(name, record.boot, record.sequence, entry.tick, record.stamp_ns, record.publish_ns)
            window.wrote(None, (), Record(record.topic, envelope, record.payload, entry))
    return window


def test_a_snapshot_counts_once_all_ticks_up_to_its_own_are_in_the_file(run: Recording) -> None:
    window = filled(run)
    offered = next(one for one in of(run, SNAPSHOT_PREFIX + NODE) if decode_snapshot(one.payload).tick > 3)
    tick = decode_snapshot(offered.payload).tick
    window.offer(NODE, offered.payload)
    for confirmed, counts in ((tick, False), (tick + 1, True)):
        window.confirm({NODE: confirmed})
        assert window.part(NODE, 0).snapshot == (offered.payload if counts else b"")


def test_a_snapshot_of_another_state_than_the_journals_does_not_count(run: Recording) -> None:
    window = filled(run)
    one, other = [decode_snapshot(record.payload) for record in of(run, SNAPSHOT_PREFIX + NODE)][-2:]
    unwritten = Window(GRAPH)
    unwritten.offer(NODE, encode(SNAPSHOT_PREFIX + NODE, other))
    unwritten.confirm({NODE: 100})
    assert unwritten.part(NODE, 0).snapshot == b"", "there is no journal to compare it with"
    for forged in (
        msgspec.structs.replace(other, state=one.state),
        msgspec.structs.replace(other, chain="0" * 64),
        msgspec.structs.replace(other, step=other.step - 1),
    ):
        window.offer(NODE, encode(SNAPSHOT_PREFIX + NODE, forged))
    window.offer(NODE, b"{}")
    window.confirm({NODE: 100})
    assert window.part(NODE, 0).snapshot == b""
    window.offer(NODE, encode(SNAPSHOT_PREFIX + NODE, other))  # the control
    window.confirm({NODE: 100})
    assert window.part(NODE, 0).snapshot != b""
