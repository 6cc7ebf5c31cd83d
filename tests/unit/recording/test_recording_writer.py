import json
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from dynpf_formats.recording.errors import RecordingError, RecordingExistsError
from dynpf_formats.recording.header import Provenance
from dynpf_formats.recording.mcap_records import Region, scan
from dynpf_formats.recording.provenance import code_digest, collect, explain_different_bytes
from dynpf_formats.recording.reader import load, read_recording
from dynpf_formats.recording.recover import recover
from dynpf_formats.recording.writer import CHUNK_BYTES, FLUSH_NS, MAX_PAYLOAD, RecordingWriter
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError, UnknownTopicError
from dynpf_protocol.journal import JournalEntry, encode_entry
from dynpf_protocol.messages import Gap
from dynpf_protocol.schemas import json_schema
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from tests.unit.recording.recorded_runs import HEADER, MAP, NODELESS, SECOND, Sent, lockstep, write

NAMES = st.text(st.characters(categories=("L", "N", "P")), min_size=1, max_size=8)


@st.composite
def messages(draw: st.DrawFn) -> list[Sent]:
    numbers: dict[tuple[str, str, str], int] = {}
    sent = []
    for _ in range(draw(st.integers(0, 12))):
        topic, node, boot = draw(st.sampled_from(sorted(known_topics()))), draw(NAMES), draw(NAMES)
        number = numbers.get((topic, node, boot), 0)
        numbers[topic, node, boot] = number + 1
        stamp, publish = draw(st.integers(0, 2**63 - 1)), draw(st.integers(0, 2**63 - 1))
        payload = draw(st.binary(max_size=300))
        sent.append(Sent(topic, Envelope(node, boot, number, 0, stamp, publish), payload))
    return sent


@settings(derandomize=True, deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(sent=messages(), flush_every=st.integers(0, 5))
def test_what_is_written_is_read(sent: list[Sent], flush_every: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = write(tmp_path_factory.mktemp("run") / "run.mcap", sent, flush_every=flush_every, header=NODELESS)
    recording = read_recording(path)
    assert recording.header == NODELESS
    assert recording.attachments == (MAP,)
    assert recording.end is not None
    assert recording.end.complete
    assert not recording.truncated
    read = [
        Sent(r.topic, Envelope(r.node, r.boot, r.sequence, 0, r.stamp_ns, r.publish_ns), r.payload)
        for r in recording.messages()
    ]
    assert read == sent


def test_other_programs_see_topics_schemas_and_senders(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", lockstep(3))
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        seen = list(reader.iter_messages())
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = [record.name for record in reader.iter_attachments()]
        profile = reader.get_header().profile
    assert profile == "dynpf"
    assert metadata["run"]["seed"] == "7"
    assert metadata["run_end"]["complete"] == "true"
    assert attachments == ["files/map.pgm"]
    assert len(seen) == 3 * 7
    for schema, channel, _ in seen:
        assert schema is not None
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        kind = JournalEntry if channel.topic.startswith("journal/") else known_topics()[channel.topic].type
        assert (schema.name, schema.data) == (kind.schema_name, json_schema(kind))
    senders = {(channel.topic, channel.metadata["node"], channel.metadata["boot"]) for _, channel, _ in seen}
    assert ("truth/robot", "simulator", "simulator-b1") in senders


def test_a_message_is_in_the_file_once_the_flush_is_due(tmp_path: Path) -> None:
    sent = lockstep(1)[0]
    with RecordingWriter(tmp_path / "run.mcap", HEADER) as writer:
        writer.flush_if_due(100)
        writer.message(*sent)
        writer.flush_if_due(100 + FLUSH_NS - 1)
        assert not load(writer.path).recording.records
        writer.flush_if_due(100 + FLUSH_NS)
        (record,) = load(writer.path).recording.records
        assert record.payload == sent.payload


def test_chunks_stay_below_their_limit_unless_one_message_is_larger(tmp_path: Path) -> None:
    sizes = [100_000] * 5 + [CHUNK_BYTES + 1] + [100_000] * 2
    sent = [Sent("log", Envelope("vision", "b", n, 0, n, n), b"x" * size) for n, size in enumerate(sizes)]
    path = write(tmp_path / "run.mcap", sent)
    with path.open("rb") as stream:
        chunks = [len(item.data) for item in scan(stream, path.stat().st_size) if isinstance(item, Region)]
    schema = 2000  # the first chunk carries schema and channel too
    assert all(size <= CHUNK_BYTES + schema or size < CHUNK_BYTES + 100 for size in chunks)
    assert len(chunks) == 5
    assert [record.size for record in read_recording(path).messages()] == sizes


def numbered(*sequences: int) -> list[Sent]:
    _, envelope, payload = lockstep(1)[0]
    return [
        Sent("truth/robot", Envelope("simulator", "b", sequence, 0, place * SECOND, envelope.publish_ns), payload)
        for place, sequence in enumerate(sequences)
    ]


def test_gaps_are_told_when_found_and_at_the_end(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path / "run.mcap", numbered(2, 3, 7, 9, 8)))
    told = [decode("recorder/gap", record.payload) for record in recording.messages("recorder/gap")]
    source = {"topic": "truth/robot", "node": "simulator", "boot": "b"}
    ranges = [(0, 1), (4, 6), (8, 8)]
    assert told == [Gap(**source, first=first, last=last) for first, last in ranges]
    assert recording.end is not None
    assert recording.end.gaps == tuple(Gap(**source, first=first, last=last) for first, last in ranges[:2])
    assert (recording.end.missing, recording.end.late, recording.end.duplicates) == (5, 1, 0)


def test_consecutive_numbers_have_no_gaps(tmp_path: Path) -> None:
    end = read_recording(write(tmp_path / "run.mcap", numbered(0, 1, 2))).end
    assert end is not None
    assert (end.gaps, end.missing, end.late, end.duplicates) == ((), 0, 0, 0)


def test_repetitions_are_recorded_and_counted(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path / "run.mcap", numbered(0, 1, 1, 0, 2)))
    assert recording.end is not None
    assert recording.end.duplicates == 2
    assert len(recording.records) == 5
    assert [record.sequence for record in recording.messages()] == [0, 1, 2]


def test_a_run_whose_journal_does_not_resolve_is_incomplete(tmp_path: Path) -> None:
    sent = lockstep(4)
    whole = read_recording(write(tmp_path / "whole.mcap", sent))
    assert whole.end is not None
    assert whole.end.complete
    lacking = [one for one in sent if (one.topic, one.envelope.sequence) != ("estimator/state", 3)]
    end = read_recording(write(tmp_path / "lacking.mcap", lacking, flush_every=2)).end
    assert end is not None
    assert not end.complete
    assert end.unresolved == 1
    assert "estimator/state 3 of estimator" in end.reason


def test_a_journal_that_comes_before_its_messages_resolves(tmp_path: Path) -> None:
    sent = sorted(lockstep(4), key=lambda one: not one.topic.startswith("journal/"))
    end = read_recording(write(tmp_path / "run.mcap", sent, flush_every=3)).end
    assert end is not None
    assert end.complete


def test_what_cannot_be_filed_is_refused(tmp_path: Path) -> None:
    envelope = Envelope("simulator", "b", 0, 0, 0, 0)
    with RecordingWriter(tmp_path / "run.mcap", HEADER) as writer:
        with pytest.raises(UnknownTopicError, match="weather"):
            writer.message("weather", envelope, b"{}")
        with pytest.raises(BadMessageError, match="journal/simulator"):
            writer.journal(envelope, b"{}")
        with pytest.raises(RecordingError, match="at most"):
            writer.message("log", envelope, bytes(MAX_PAYLOAD + 1))
        writer.journal(envelope, encode_entry(JournalEntry(step=0, tick=0, stamp_ns=0, consumed=(), produced=())))
        end = writer.close(complete=True, reason="finished")
    assert end.counts == {"journal/simulator": 1}
    with pytest.raises(RecordingError, match="closed"):
        writer.message("log", envelope, b"{}")


def test_an_existing_file_is_kept_unless_told_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with pytest.raises(RecordingExistsError, match=r"run\.mcap: the file exists"):
        RecordingWriter(path, HEADER)
    assert path.read_text() == "precious"
    RecordingWriter(path, HEADER, overwrite=True).close(complete=True, reason="finished")
    assert read_recording(path).end is not None


def test_an_error_inside_the_run_leaves_an_incomplete_recording(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), RecordingWriter(tmp_path / "run.mcap", HEADER) as writer:
        writer.message(*lockstep(1)[0])
        raise ZeroDivisionError("oh")
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.end is not None
    assert not recording.end.complete
    assert "oh" in recording.end.reason
    assert len(recording.records) == 1


def test_places_where_nothing_can_be_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere/run\.mcap: cannot be written"):
        RecordingWriter(tmp_path / "nowhere" / "run.mcap", HEADER)
    if Path("/dev/full").exists():
        with pytest.raises(RecordingError, match="/dev/full: no room left"):
            RecordingWriter("/dev/full", HEADER, overwrite=True)


def test_a_full_disk_leaves_what_was_written_recoverable(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sent = [Sent("log", Envelope("vision", "b", n, 0, n, n), str(n).encode() * 5000) for n in range(200)]
    writer = RecordingWriter(path, HEADER)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, hard))
    try:
        with pytest.raises(RecordingError, match=r"run\.mcap: no room left"):
            for one in sent:
                writer.message(*one)
        with pytest.raises(RecordingError, match="no room left"):
            writer.message(*sent[0])
        end = writer.close(complete=True, reason="finished")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not end.complete
    assert "no room left" in end.reason
    recovery = recover(path, tmp_path / "mended.mcap")
    assert recovery.kept > 20
    mended = read_recording(tmp_path / "mended.mcap")
    assert [record.payload for record in mended.messages()] == [one.payload for one in sent[: recovery.kept]]


def test_provenance_names_code_packages_and_platform() -> None:
    provenance = collect()
    assert provenance.code_digest == code_digest()
    assert {"mcap", "msgspec", "numpy"} <= provenance.packages.keys()
    libraries = {"libm", "blas", "numpy_simd", "opencv_simd", "opencv_ipp", "numba_cpu"}
    assert provenance.platform.keys() == {"system", "machine", "python"} | libraries
    assert all(provenance.platform.values())


def test_provenance_names_what_chooses_kernels_by_the_environment() -> None:
    told = (
        "from dynpf_formats.recording.provenance import platform_fingerprint as f; import json; print(json.dumps(f()))"
    )
    chosen = {"OPENBLAS_CORETYPE": "Nehalem", "GLIBC_TUNABLES": "glibc.malloc.check=0", "NUMBA_CPU_NAME": "generic"}
    ended = subprocess.run(
        [sys.executable, "-c", told], env={**os.environ, **chosen}, capture_output=True, text=True, check=True
    )
    platform = json.loads(ended.stdout)
    assert platform["libm"].endswith("with GLIBC_TUNABLES=glibc.malloc.check=0")
    assert platform["numba_cpu"].startswith("generic")
    if "x86_64" in platform["machine"]:
        assert platform["blas"].endswith(" Nehalem")


MADE = Provenance(dynpf_version="1", code_digest="c", packages={"numpy": "2.4"}, platform={"system": "X", "blas": "A"})


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, ""),
        ({"code_digest": "d"}, ""),
        ({"platform": {"system": "X", "blas": "A", "libm": "told only here"}}, ""),
        ({"platform": {"system": "X", "blas": "B"}}, "recorded with BLAS A, here B; bytes should be .* please report"),
        ({"platform": {"system": "X", "blas": "B"}, "code_digest": "d"}, "BLAS A, here B; .* code differs, too"),
        ({"platform": {"system": "Y", "blas": "B"}}, "recorded with system X, here Y"),
        ({"packages": {"numpy": "2.5"}, "platform": {"system": "Y"}}, "numpy 2.4, here 2.5; .* for equal versions"),
        ({"packages": {}}, "numpy 2.4, here none"),
    ],
)
def test_where_bytes_differ_the_first_difference_of_what_made_them_is_told(
    changes: dict[str, object], told: str
) -> None:
    found = explain_different_bytes(MADE, msgspec.structs.replace(MADE, **changes))
    assert re.search(told, found)
    assert bool(found) == bool(told)
