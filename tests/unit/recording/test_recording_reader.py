import io
import lzma
import struct
import tarfile
import tracemalloc
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard
from dynpf_formats.recording import index
from dynpf_formats.recording.doctor import Severity, examine
from dynpf_formats.recording.errors import (
    CorruptRecordingError,
    ForeignRecordingError,
    NotMcapError,
    RecordingError,
    TruncatedRecordingError,
    UnknownVersionError,
    UnreadableHeaderError,
)
from dynpf_formats.recording.header import as_entries
from dynpf_formats.recording.mcap_records import MAX_ATTACHMENT
from dynpf_formats.recording.reader import Recorded, load, read_recording
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, ChunkIndex, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC, Writer

from tests.unit.recording.recorded_runs import HEADER, MAP, lockstep, write

DATA = Path(__file__).parents[3] / "../shared/data/mcap"


def test_references_journal_and_ticks(tmp_path: Path) -> None:
    sent = lockstep(4)
    recording = read_recording(write(tmp_path / "run.mcap", sent))
    state = recording.find("estimator", "estimator-b1", "estimator/state", 2)
    assert state is not None
    assert (state.stamp_ns, state.size) == (10**8, len(state.payload))
    assert recording.tick_of(state) == 2
    assert recording.find("estimator", "estimator-b1", "estimator/state", 4) is None
    assert recording.find("estimator", "another", "estimator/state", 2) is None
    (diagnostics,) = (record for record in recording.messages("diagnostics") if record.sequence == 1)
    assert recording.tick_of(diagnostics) is None
    assert recording.journals() == tuple((node, f"{node}-b1") for node in ("simulator", "sensors", "estimator"))
    steps = list(recording.journal("estimator", "estimator-b1"))
    assert [entry.step for entry in steps] == [0, 1, 2, 3]
    assert steps[1].consumed[0].topic == "sensors/overhead"
    assert recording.boots("estimator") == ("estimator-b1",)
    assert [record.sequence for record in recording.messages(node="simulator")] == [0, 1, 2, 3]


def test_payloads_are_fetched_again_when_the_cache_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = lockstep(20)
    path = write(tmp_path / "run.mcap", sent, flush_every=10)
    monkeypatch.setattr(index, "_CACHE_BYTES", 1)
    recording = read_recording(path)
    assert [record.payload for record in reversed(recording.records)] == [one.payload for one in reversed(sent)]
    data = bytearray(path.read_bytes())
    data[data.rindex(b"\x04\x00\x00\x00zstd", 0, data.index(b"run_end")) + 30] ^= 1
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="changed while it was in use"):
        _ = recording.records[-1].payload, recording.records[0].payload, recording.records[-1].payload


@pytest.mark.parametrize(
    ("content", "error", "text"),
    [
        (b"", NotMcapError, "the file is empty"),
        (b"hello, world", NotMcapError, "not an MCAP file: it begins with b'hello, w'"),
        (MCAP0_MAGIC[:5], TruncatedRecordingError, "ends inside its first bytes"),
        (MCAP0_MAGIC, TruncatedRecordingError, "ends before the metadata of the run"),
    ],
)
def test_files_that_are_no_recording(tmp_path: Path, content: bytes, error: type[RecordingError], text: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(error, match=text):
        read_recording(path)
    (finding,) = examine(path)
    assert finding.severity is Severity.UNREADABLE
    assert text in finding.what


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none\.mcap: no such file"):
        read_recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match="cannot be read: it is a folder"):
        read_recording(tmp_path)


def with_header(path: Path, entries: dict[str, str]) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start("dynpf")
        writer.add_metadata("run", entries)
        writer.finish()
    return path


def test_another_schema_version_is_refused_naming_its_writer(tmp_path: Path) -> None:
    entries = as_entries(HEADER)
    assert read_recording(with_header(tmp_path / "a.mcap", entries)).header == HEADER
    newer = {key: value for key, value in entries.items() if key != "sha256"} | {
        "schema_version": "4",
        "dynpf_version": "9.1",
    }
    from dynpf_formats.recording import header  # noqa: PLC0415

    newer["sha256"] = header.checksum(newer)
    with pytest.raises(UnknownVersionError, match=r"schema version 4, written by dynpf 9\.1; this dynpf reads 3"):
        read_recording(with_header(tmp_path / "b.mcap", newer))


@pytest.mark.parametrize("key", ["seed", "scenario", "sha256", "packages", "provenance"])
def test_unreadable_run_metadata(tmp_path: Path, key: str) -> None:
    entries = {**as_entries(HEADER), key: "?"}
    with pytest.raises(UnreadableHeaderError, match="metadata of the run are unreadable"):
        read_recording(with_header(tmp_path / "a.mcap", entries))


# --- other people's files ------------------------------------------------------------------------------------------


def foreign_files() -> Iterator[tuple[str, bytes]]:
    for path in sorted(DATA.rglob("*.mcap")):
        yield path.name, path.read_bytes()
    with lzma.open(DATA / "foxglove_conformance/conformance.tar.xz") as packed, tarfile.open(fileobj=packed) as archive:
        for member in archive:
            stream = archive.extractfile(member) if member.name.endswith(".mcap") else None
            if stream is not None:
                yield member.name, stream.read()


def test_other_peoples_files_are_refused_in_one_line(tmp_path: Path) -> None:
    if not DATA.is_dir():
        pytest.skip(f"other people's files are not at {DATA}")
    path = tmp_path / "foreign.mcap"
    count = 0
    for name, data in foreign_files():
        count += 1
        path.write_bytes(data)
        with pytest.raises(ForeignRecordingError, match="not a dynpf recording: no run metadata; profile") as refused:
            read_recording(path)
        assert "\n" not in str(refused.value), name
        (finding,) = examine(path)
        assert finding.severity is Severity.UNREADABLE
        if "OneMessage" in name and "pad" not in name:
            assert "topics 'example'" in str(refused.value), name
        elif name == "talker.mcap":
            assert "profile 'ros2', topics '/rosout', '/parameter_events', '/topic'" in str(refused.value)
    assert count == 416 + 21


# --- hostile files -------------------------------------------------------------------------------------------------


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def built(item: Metadata | Chunk | Message | Schema | ChunkIndex) -> bytes:
    builder = RecordBuilder()
    item.write(builder)
    data: bytes = builder.end()
    return data


def chunk(data: bytes, uncompressed: bytes | None = None, size: int | None = None, compression: str = "zstd") -> bytes:
    plain = data if uncompressed is None else uncompressed
    return built(
        Chunk(
            compression=compression,
            data=data,
            message_start_time=0,
            message_end_time=0,
            uncompressed_crc=zlib.crc32(plain),
            uncompressed_size=len(plain) if size is None else size,
        )
    )


def hostile() -> dict[str, bytes]:
    packer = zstandard.ZstdCompressor(level=3)
    zeros = bytes(2**20)
    huge = packer.compress(zeros)
    lying = bytearray(packer.compress(zeros))
    lying[6:10] = b"\xff\xff\xff\x7f"  # somewhere in the frame's own claim of its size
    message = built(Message(channel_id=1, log_time=0, data=b"", publish_time=0, sequence=0))
    many = message * 100_000
    bomb = chunk(packer.compress(many), many)
    return {
        "huge record": record(0x06, b"", 2**62),
        "huge record, largest number": record(0x06, b"", 2**64 - 1),
        "huge string": record(0x0C, struct.pack("<I", 2**32 - 1) + b"name"),
        "huge map": record(0x0C, struct.pack("<I", 1) + b"x" + struct.pack("<I", 2**32 - 1)),
        "huge chunk": chunk(huge, zeros, size=2**40),
        "huge claim in the compressed data": chunk(bytes(lying), zeros),
        "bomb": chunk(huge, b"x" * 10),
        "huge data in chunk": record(0x06, struct.pack("<QQQII", 0, 0, 10, 0, 0) + struct.pack("<Q", 2**63)),
        "huge message in chunk": chunk(record(0x05, b"", 2**50), compression=""),
        "huge attachment": record(0x09, struct.pack("<QQII", 0, 0, 0, 0) + struct.pack("<Q", 2**60) + bytes(4)),
        "large attachment": record(0x09, bytes(MAX_ATTACHMENT + 1)),
        "records without end": b"\x00" * 500_000,
        "many messages in little space": bomb * 50,
        "messages outside chunks": record(0x05, bytes(22)) * 100_000,
        "chunks that are none": b"\x06" + (b"\xff" * 8 + b"\x04\x00\x00\x00zstd") * 10_000,
    }


@pytest.mark.parametrize("name", hostile())
def test_hostile_files_take_little_memory(tmp_path: Path, name: str) -> None:
    start = MCAP0_MAGIC + record(0x01, struct.pack("<I", 5) + b"dynpf" + struct.pack("<I", 0))
    path = tmp_path / "hostile.mcap"
    path.write_bytes(start + built(Metadata("run", as_entries(HEADER))) + hostile()[name])
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match=r"hostile\.mcap: "):
            read_recording(path, allow_truncated=name.startswith("many"))
        assert examine(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 40 * 2**20


def test_messages_on_a_channel_that_is_not_described(tmp_path: Path) -> None:
    message = built(Message(channel_id=9, log_time=0, data=b"{}", publish_time=0, sequence=0))
    start = MCAP0_MAGIC + record(0x01, struct.pack("<I", 5) + b"dynpf" + struct.pack("<I", 0))
    path = tmp_path / "run.mcap"
    path.write_bytes(start + built(Metadata("run", as_entries(HEADER))) + chunk(message, compression=""))
    assert not load(path).recording.records
    assert any("channels that the file does not describe" in finding.what for finding in examine(path))


def test_an_altered_attachment_is_found(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", lockstep(1), close=False)
    data = path.read_bytes()
    path.write_bytes(data.replace(MAP.data, MAP.data[::-1]))
    with pytest.raises(CorruptRecordingError, match=r"attachment 'files/map\.pgm': its checksum does not match"):
        read_recording(path, allow_truncated=True)


def test_a_recorded_message_shows_what_it_is(tmp_path: Path) -> None:
    (record, *_) = read_recording(write(tmp_path / "run.mcap", lockstep(1))).records
    assert isinstance(record, Recorded)
    assert "truth/robot 0 of simulator" in repr(record)


def test_the_library_reads_from_a_stream_only_what_is_there() -> None:
    """The control for reading record bodies ourselves: the library's own stream takes a short read for a whole one."""
    from mcap.data_stream import ReadDataStream  # noqa: PLC0415

    assert ReadDataStream(io.BytesIO(b"abc")).read(10) == b"abc"
