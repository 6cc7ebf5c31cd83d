"""A part of a run is executed from its snapshots and few chunks of the file; whatever the file says, never wrongly."""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import pytest
from dynpf_formats.recording import seek, writer
from dynpf_formats.recording.errors import CorruptRecordingError
from dynpf_formats.recording.mcap_records import Region
from dynpf_formats.recording.reader import Recorded, Recording, read_recording
from dynpf_formats.recording.seek import Moment
from dynpf_formats.recording.summary import Chunk, read_chunk
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import Command, Snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX, pack, unpack
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.replay_part import Part, moment_of, replay_parts
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from msgspec.structs import replace

TICKS = 600
NODES = ("simulator", "sensors", "estimator", "controller")
FOOTER = 37  # bytes, with the magic after it


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(writer, "CHUNK_BYTES", 16 * 1024)  # two ticks each: as many chunks as a long run has
        record_inline(load_scenario("landmark-room", overrides=[f"max_ticks={TICKS}", "estimator.n=30"]), path)
    return path


def replayed(path: Path, first: str | None, last: str | None, node: str | None = None) -> Part:
    moments = [None if text is None else moment_of(text) for text in (first, last)]
    return replay_parts(path, node, moments[0], moments[1], ())


def edited(path: Path, target: Path, edit: Callable[[Recorded], bytes]) -> Path:
    """Write a recording anew, with other payloads."""
    recording = read_recording(path)
    with RecordingWriter(target, recording.header, recording.attachments, topics=recording.topics) as writer:
        for record in recording.records:
            envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
            writer.message(record.topic, envelope, edit(record))
        writer.close(complete=True, reason="finished", outcome="budget spent")
    return target


@settings(max_examples=8, deadline=None, derandomize=True)
@given(first=st.integers(0, TICKS - 1), length=st.integers(0, 40), node=st.sampled_from(NODES))
def test_any_part_is_the_same_and_counts_its_own_steps(path: Path, first: int, length: int, node: str) -> None:
    last = min(first + length, TICKS - 1)
    for begin, end in ((f"tick:{first}", f"tick:{last}"), (f"{first / 10}s", f"{last / 10}s")):
        part = replayed(path, begin, end, node)
        ((outcome, snapshot),) = part.nodes
        assert (part.unread, outcome.mismatch, outcome.steps) == ("", None, last - first + 1)
        assert snapshot is None or snapshot < first
        assert snapshot is not None or first < 300, "snapshots are taken"


def test_it_reads_only_the_chunks_that_it_needs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []

    def counted(file: BinaryIO, chunk: Chunk) -> Region:
        read.append(chunk.offset)
        return read_chunk(file, chunk)

    monkeypatch.setattr(seek, "read_chunk", counted)
    replayed(path, "tick:590", "tick:595", "estimator")
    with seek.Indexed(path) as indexed:
        assert 0 < len({*read}) < indexed.chunks / 3


@pytest.mark.parametrize("text", ["12", "tick:", "tick:1.5", "-1s", "nans", "1e30s", "5m"])
def test_what_is_no_moment_is_told(text: str) -> None:
    with pytest.raises(UsageError, match="expected a time such as 120s, or a tick such as tick:500"):
        moment_of(text)
    assert moment_of("1.5s") == Moment("ns", 1_500_000_000)


def test_a_changed_message_or_journal_is_found_where_it_is(path: Path, tmp_path: Path) -> None:
    def faster(record: Recorded) -> bytes:
        changed = record.topic == "controller/command" and record.sequence == 550
        return encode(record.topic, Command(vx=9.0)) if changed else record.payload

    part = replayed(edited(path, tmp_path / "faster.mcap", faster), "tick:545", "tick:555")
    found = {node.outcome.node: node.outcome.mismatch for node in part.nodes}
    mismatch = found["controller"]
    assert mismatch is not None
    assert (mismatch.field, mismatch.tick, mismatch.recorded) == ("vx", 550, 9.0)
    assert found["estimator"] is None, "it reads no commands"

    def unchained(record: Recorded) -> bytes:
        there = record.topic == "journal/sensors" and record.sequence == 549
        return record.payload.replace(b'"chain":"', b'"chain":"0', 1) if there else record.payload

    part = replayed(edited(path, tmp_path / "unchained.mcap", unchained), "tick:545", "tick:555", "sensors")
    mismatch = part.nodes[0].outcome.mismatch
    assert mismatch is not None
    assert (mismatch.field, mismatch.tick) == ("chain", 549)


def test_a_snapshot_that_the_journal_contradicts_is_passed_over(path: Path, tmp_path: Path) -> None:
    steps = [one.step for one in snapshots(read_recording(path), "estimator")]
    assert len(steps) > 2

    def forged(record: Recorded) -> bytes:
        if record.topic != "snapshot/estimator":
            return record.payload
        snapshot = decode(record.topic, record.payload)
        assert isinstance(snapshot, Snapshot)
        frozen = unpack(snapshot.state)
        packed = pack(replace(frozen, state=frozen.state.replace(b"\x00", b"\x01")))
        assert packed is not None
        wrong = snapshot.step in chosen
        return encode(record.topic, replace(snapshot, state=packed)) if wrong else record.payload

    chosen = {steps[-1]}
    part = replayed(edited(path, tmp_path / "last.mcap", forged), "tick:590", None, "estimator")
    assert (part.nodes[0].snapshot, part.nodes[0].outcome.mismatch) == (steps[-2], None)
    chosen = {*steps}
    part = replayed(edited(path, tmp_path / "all.mcap", forged), "tick:590", None, "estimator")
    assert (part.nodes[0].snapshot, part.nodes[0].outcome.mismatch) == (None, None)


def snapshots(recording: Recording, node: str) -> list[Snapshot]:
    found = [decode(one.topic, one.payload) for one in recording.messages(SNAPSHOT_PREFIX + node)]
    return [one for one in found if isinstance(one, Snapshot)]


def cut(data: bytes) -> bytes:
    return data[:-20]


def damaged(data: bytes) -> bytes:
    (start,) = struct.unpack_from("<Q", data, len(data) - FOOTER + 9)
    return data[: start + 30] + bytes([data[start + 30] ^ 1]) + data[start + 31 :]


def without_the_last_chunks(data: bytes) -> bytes:
    """Take the last five chunks out of the summary, and make its checksum right again."""
    (start,) = struct.unpack_from("<Q", data, len(data) - FOOTER + 9)
    records, position = [], start
    while position < len(data) - FOOTER:
        length = 9 + struct.unpack_from("<Q", data, position + 1)[0]
        records.append(data[position : position + length])
        position += length
    chunks = [record for record in records if record[0] == Opcode.CHUNK_INDEX]
    summary = b"".join(record for record in records if record not in chunks[-5:])
    footer = data[-FOOTER : -FOOTER + 25]
    crc = zlib.crc32(footer, zlib.crc32(summary))
    return data[:start] + summary + footer + struct.pack("<I", crc) + data[-8:]


@pytest.mark.parametrize(
    ("edit", "why"),
    [
        (cut, "does not end with its footer"),
        (without_the_last_chunks, "its index does not lead to the end of the journal"),
    ],
)
def test_a_file_whose_index_is_not_to_be_had_is_read_as_a_whole(
    path: Path, tmp_path: Path, edit: Callable[[bytes], bytes], why: str
) -> None:
    (tmp_path / "run.mcap").write_bytes(edit(path.read_bytes()))
    part = replayed(tmp_path / "run.mcap", "tick:570", None, "sensors")
    assert why in part.unread
    assert part.nodes[0].outcome.mismatch is None
    assert part.nodes[0].outcome.steps > 0


def test_a_damaged_file_is_refused_as_any_replay_refuses_it(path: Path, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(damaged(path.read_bytes()))
    with pytest.raises(CorruptRecordingError):
        replayed(tmp_path / "run.mcap", "tick:570", None, "sensors")


def test_the_command_says_where_it_went_on_and_how_fast(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(path), "--from", "58s", "--until", "58.5s", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["same"] is True
    assert {name: row["steps"] for name, row in told["counts"].items()} == dict.fromkeys(NODES, 6)
    assert all(0 < step < 580 for step in told["snapshots"].values())
    assert told["speed"] > 0
    assert main(["replay", str(path), "--until", "tick:20", "--node", "sensors"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("sensors     same     21 steps")
    assert lines[1].endswith("times real time on one core, start-up excluded")
    assert main(["replay", str(path), "--from", "1s", "--set", "estimator.n=5"]) == 2
    assert "they go without --set and -o" in capsys.readouterr().err


@pytest.mark.parametrize(("first", "last"), [("999s", None), (f"tick:{TICKS}", None), ("20s", "10s")])
def test_a_part_without_a_step_is_no_run_that_is_the_same(path: Path, first: str, last: str | None) -> None:
    with pytest.raises(UsageError, match="has no step between these moments"):
        replayed(path, first, last)
    assert all(node.outcome.steps == 1 for node in replayed(path, f"tick:{TICKS - 1}", None).nodes)
