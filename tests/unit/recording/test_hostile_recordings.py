"""Files that were made to harm who reads them, each checksum right: refused in a sentence, or read within bounds."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from dynpf_formats.recording import mcap_records
from dynpf_formats.recording.doctor import examine
from dynpf_formats.recording.errors import CorruptRecordingError, ForeignRecordingError, RecordingError
from dynpf_formats.recording.mcap_records import MAX_RECORD
from dynpf_formats.recording.reader import load, read_recording
from dynpf_formats.recording.recover import recover
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from checks.fuzz.anatomy import Anatomy, Cluster
from tests.unit.recording.recorded_runs import MAP, lockstep, write


@pytest.fixture
def anatomy(tmp_path: Path) -> Anatomy:
    return Anatomy.of(write(tmp_path / "sound.mcap", lockstep(3)).read_bytes())


def written(folder: Path, anatomy: Anatomy) -> Path:
    path = folder / "hostile.mcap"
    path.write_bytes(anatomy.bytes())
    return path


SCHEMA = Schema(id=1, data=b"", encoding="jsonschema", name="")


def channel(topic: str, node: str) -> Channel:
    return Channel(id=1, topic=topic, message_encoding="json", metadata={"node": node, "boot": "b"}, schema_id=1)


@pytest.mark.parametrize(
    ("cluster", "expected"),
    [
        (Cluster([SCHEMA] * 300_000), "claims more channels and schemas than a file of its size holds"),
        (Cluster([channel("log/truth", str(node)) for node in range(20_000)]), "damaged in more than 10000 places"),
    ],
    ids=["schemas", "conflicting channels"],
)
def test_a_chunk_cannot_hold_ever_more_descriptions(
    anatomy: Anatomy, tmp_path: Path, cluster: Cluster, expected: str
) -> None:
    anatomy.items.insert(1, cluster)
    path = written(tmp_path, anatomy)
    with pytest.raises(CorruptRecordingError, match=expected):
        load(path)


def test_topics_of_a_foreign_file_are_looked_for_in_the_beginnings_of_its_chunks(
    anatomy: Anatomy, tmp_path: Path
) -> None:
    anatomy.header.profile, anatomy.summary = "", False

    def refused(*before: Schema) -> str:
        anatomy.items[:] = [item for item in anatomy.items if not isinstance(item, Metadata | Cluster)]
        anatomy.items.insert(1, Cluster([*before, channel("scan", "lidar")]))
        with pytest.raises(ForeignRecordingError) as error:
            load(written(tmp_path, anatomy))
        return str(error.value)

    assert "topics 'scan'" in refused()
    assert "no topics" in refused(*[SCHEMA] * 2000)


def test_chunks_unpack_to_a_multiple_of_the_files_size(anatomy: Anatomy, tmp_path: Path) -> None:
    large = b"\x05" + (MAX_RECORD - 9).to_bytes(8, "little") + bytes(MAX_RECORD - 9)
    anatomy.items[1:1] = [Cluster([], tail=large)] * 3
    damage = [found.text for found in load(written(tmp_path, anatomy)).damage]
    assert sum("more than a file of this size may unpack to" in text for text in damage) >= 2
    assert not any("unpack to" in text for text in examine_texts(tmp_path / "sound.mcap"))


def examine_texts(path: Path) -> list[str]:
    return [finding.what for finding in examine(path)]


def test_a_large_chunk_holds_one_message(anatomy: Anatomy, tmp_path: Path) -> None:
    several = (b"\x05" + (2**20).to_bytes(8, "little") + bytes(2**20)) * 9
    anatomy.items.insert(2, Cluster([], tail=several))
    damage = load(written(tmp_path, anatomy)).damage
    assert damage[0].text == f"a chunk of {len(several)} bytes; of several messages it has at most {8 * 2**20}"


def test_attachments_are_bounded_and_have_names_of_their_own(anatomy: Anatomy, tmp_path: Path) -> None:
    anatomy.items[1:1] = [Attachment(0, 0, f"a{number}", "", bytes(2**25)) for number in range(5)]
    with pytest.raises(CorruptRecordingError, match="has attachments of over"):
        load(written(tmp_path, anatomy))
    anatomy.items[1:6] = [Attachment(0, 0, MAP.name, "", b"another")]
    recording, damage = load(written(tmp_path, anatomy))
    assert [found.text for found in damage] == ["two attachments are called 'files/map.pgm'; the first is taken"]
    assert recording.attachments[0].data == b"another"


def test_repeated_attachments_count_as_others_do(anatomy: Anatomy, tmp_path: Path) -> None:
    anatomy.items[1:1] = [Attachment(0, 0, "a", "", bytes(2**25))] * 5
    with pytest.raises(CorruptRecordingError, match="has attachments of over"):
        load(written(tmp_path, anatomy))


def test_messages_that_alternate_between_chunks_do_not_unpack_one_each(
    anatomy: Anatomy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = [record for cluster in anatomy.clusters() for record in cluster.records]
    messages = [record for record in records if isinstance(record, Message)]
    described = [record for record in records if not isinstance(record, Message)]
    place = anatomy.items.index(anatomy.clusters()[0])
    anatomy.items[place:] = [Cluster([*described, *messages[first::4]]) for first in range(4)]
    path = written(tmp_path, anatomy)
    expected = [record.payload for record in read_recording(path, allow_truncated=True).records]
    monkeypatch.setattr("dynpf_formats.recording.index._CACHE_BYTES", 0)
    monkeypatch.setattr("dynpf_formats.recording.index._UNPACKED_AGAIN", 0)
    recording = read_recording(path, allow_truncated=True)
    unpacked: list[int] = []

    def unpack(body: bytes) -> bytes:
        unpacked.append(len(body))
        return mcap_records.unpack(body)

    monkeypatch.setattr("dynpf_formats.recording.index.unpack", unpack)
    count = len(expected)
    assert count > 20
    in_turn = [number for first in range(5) for number in range(first, count, 5)] * 3
    assert all(recording.records[number].payload == expected[number] for number in in_turn)
    assert len(unpacked) == 4


def test_checksums_that_were_not_computed_are_no_damage(anatomy: Anatomy, tmp_path: Path) -> None:
    anatomy.data_crc, anatomy.chunk_crc, anatomy.summary = False, False, False
    assert examine(written(tmp_path, anatomy)) == []


def test_a_wrong_checksum_over_the_data_is_damage(anatomy: Anatomy, tmp_path: Path) -> None:
    path = written(tmp_path, anatomy)
    data = path.read_bytes()
    at = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0") + 9
    path.write_bytes(data[:at] + b"\1\1\1\1" + data[at + 4 :])
    assert "does not match" in examine_texts(path)[0]


def fifo(folder: Path) -> Path:
    os.mkfifo(folder / "fifo")
    return folder / "fifo"


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (fifo, "a pipe or a device; expected a regular file"),
        (lambda _: Path("/dev/zero"), "a pipe or a device; expected a regular file"),
        (lambda folder: folder, "it is a folder"),
        (lambda folder: folder / ("n" * 300), "File name too long"),
        (lambda folder: folder / "a\0b", "embedded null byte"),
    ],
    ids=["fifo", "device", "folder", "long name", "null"],
)
def test_what_is_no_regular_file_is_not_read(tmp_path: Path, made: Callable[[Path], Path], expected: str) -> None:
    with pytest.raises(RecordingError, match=f"cannot be read: {expected}"):
        read_recording(made(tmp_path))


def test_an_output_with_too_long_a_name_is_refused(anatomy: Anatomy, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be written: File name too long"):
        recover(written(tmp_path, anatomy), tmp_path / ("n" * 300))
