"""Files that were cut off or altered: an error or a finding, never an accident and never other content in silence."""

from pathlib import Path
from typing import Any

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.doctor import examine
from dynpf_formats.recording.errors import RecordingError, RecordingExistsError
from dynpf_formats.recording.mcap_records import Message, Region, contents, scan
from dynpf_formats.recording.reader import Recording, load, read_recording
from dynpf_formats.recording.recover import recover
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from tests.unit.recording.recorded_runs import lockstep, write


def content(recording: Recording) -> tuple[Any, ...]:
    records = [(r.source, r.sequence, r.stamp_ns, r.publish_ns, r.payload) for r in recording.records]
    return recording.header, recording.attachments, recording.end, records, content_digest(recording)


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """Return (where a chunk ends, messages up to there) for each chunk."""
    ends = [(0, 0)]
    with path.open("rb") as stream:
        for item in scan(stream, path.stat().st_size):
            if isinstance(item, Region):
                count = sum(isinstance(record, Message) for record in contents(item.data))
                ends.append((item.offset + item.length, ends[-1][1] + count))
    return ends


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sent = [one for one in lockstep(3) if one.envelope.node == "simulator"]
    return write(tmp_path_factory.mktemp("small") / "run.mcap", sent, flush_every=2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("whole") / "run.mcap", lockstep(3), flush_every=7)


def test_a_file_cut_anywhere_is_refused_and_every_whole_chunk_recovered(small: Path, tmp_path: Path) -> None:
    data, ends = small.read_bytes(), chunk_ends(small)
    original = [record.payload for record in read_recording(small).records]
    cut, mended = tmp_path / "cut.mcap", tmp_path / "mended.mcap"
    header_ends = None
    sizes = {*range(0, len(data), 3), *(end + near for end, _ in ends for near in (-1, 0, 1))} & {*range(len(data))}
    for size in sorted(sizes):
        cut.write_bytes(data[:size])
        try:
            recording = read_recording(cut, allow_truncated=True)
        except RecordingError as error:
            assert str(error).startswith(f"{cut}: ")
            assert header_ends is None
            continue
        header_ends = header_ends or size
        kept = max(messages for end, messages in ends if end <= size)
        assert recording.truncated
        assert [record.payload for record in recording.records] == original[:kept]
        if size % 63 == 0 or any(abs(size - end) <= 1 for end, _ in ends):
            with pytest.raises(RecordingError, match=r"cut\.mcap: the file ends"):
                read_recording(cut)
            assert examine(cut)
            mended.unlink(missing_ok=True)
            assert recover(cut, mended).kept == kept
            again = read_recording(mended)
            assert [record.payload for record in again.records] == original[:kept]
            assert again.end is not None
            assert not again.end.complete or recording.end is not None
    assert header_ends is not None
    assert header_ends < ends[1][0]


@settings(derandomize=True, deadline=None, max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(place=st.floats(0, 1, exclude_max=True), bits=st.integers(1, 255), length=st.sampled_from([1, 1, 1, 0.7]))
def test_flipped_bits_never_change_the_content_in_silence(whole: Path, place: float, bits: int, length: float) -> None:
    data = bytearray(whole.read_bytes())
    if length < 1:
        del data[int(len(data) * length) :]
    altered = whole.with_name("altered.mcap")
    altered.write_bytes(data)
    reference = content(load(altered).recording)
    data[int(place * len(data))] ^= bits
    altered.write_bytes(data)
    findings = examine(altered)
    try:
        recording = read_recording(altered, allow_truncated=length < 1)
    except RecordingError as error:
        assert findings
        assert "\n" not in str(error)
        return
    found = content(recording)
    if found != reference:  # a longer record can only seem to be cut off in a file that was cut off
        assert length < 1
        assert recording.truncated
        assert found[:2] == reference[:2]
        assert found[2] in (reference[2], None)
        assert found[3] == reference[3][: len(found[3])]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_recovery_leaves_out_the_damaged_chunk_and_goes_on_behind_it(whole: Path, tmp_path: Path, place: int) -> None:
    ends = chunk_ends(whole)
    data = bytearray(whole.read_bytes())
    data[ends[place + 1][0] - 20] ^= 1  # inside the compressed data
    altered = tmp_path / "altered.mcap"
    altered.write_bytes(data)
    with pytest.raises(RecordingError, match=r"chunk.*at byte"):
        read_recording(altered)
    recovery = recover(altered, tmp_path / "mended.mcap")
    assert recovery.kept == 14
    assert len(recovery.damage) == 1
    original = [record.payload for record in read_recording(whole).records]
    mended = read_recording(tmp_path / "mended.mcap")
    kept = [record.payload for record in mended.records if record.topic != "recorder/gap"]
    assert kept == original[: 7 * place] + original[7 * (place + 1) :]
    assert mended.end is not None
    assert not mended.end.complete
    assert mended.end.missing == (7 if place < 2 else 0)


def test_recovery_finds_the_next_chunk_where_the_framing_is_lost(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    second = chunk_ends(whole)[1][0]
    start = data.index(b"\x04\x00\x00\x00zstd", second) - 37  # where the record of the second chunk begins
    data[start + 5] ^= 0xFF  # its length
    altered = tmp_path / "altered.mcap"
    altered.write_bytes(data)
    with pytest.raises(RecordingError, match="byte"):
        read_recording(altered, allow_truncated=True)
    assert recover(altered, tmp_path / "mended.mcap").kept == 14


def test_an_unfinished_file_is_recovered_up_to_the_last_flush(tmp_path: Path) -> None:
    sent = lockstep(20)
    killed = write(tmp_path / "killed.mcap", sent, flush_every=50, close=False)
    findings = examine(killed)
    assert any("truncated" in finding.what for finding in findings)
    assert any("never written" in finding.what for finding in findings)
    mended = tmp_path / "mended.mcap"
    recovery = recover(killed, mended)
    assert (recovery.kept, recovery.complete, recovery.missing) == (100, False, 0)
    assert recovery.last_stamp_ns == sent[99].envelope.stamp_ns
    with mended.open("rb") as stream:
        assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) == 100
    assert [record.payload for record in read_recording(mended).records] == [one.payload for one in sent[:100]]


def test_recovery_of_a_whole_recording_loses_nothing(whole: Path, tmp_path: Path) -> None:
    recovery = recover(whole, tmp_path / "copy.mcap")
    assert recovery.complete
    assert recovery.damage == ()
    assert content(read_recording(tmp_path / "copy.mcap")) == content(read_recording(whole))


def test_recovery_overwrites_nothing(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "there.mcap").write_text("precious")
    with pytest.raises(RecordingExistsError):
        recover(whole, tmp_path / "there.mcap")
    assert (tmp_path / "there.mcap").read_text() == "precious"
