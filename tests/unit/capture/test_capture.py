"""Captures: what is written is read back with its losses, from files that are cut off, damaged or made up, too."""

import json
import random

import pytest
from dynpf_formats.capture.form import END, Began, Dropped
from dynpf_formats.capture.reader import is_capture, read_capture
from dynpf_formats.capture.recover import recover_capture
from dynpf_formats.capture.report import describe, examine, summary_lines
from dynpf_formats.capture.writer import CaptureWriter, Sample
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.findings import Severity
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import NO_HASH, Published
from dynpf_formats.ros2.types import Releases, RosTypes
from dynpf_lab.cli.main import main
from mcap.reader import make_reader

STRING = "std_msgs/msg/String"
BEGAN = Began(dynpf_version="0", connect="tcp/robot:7447", keys=("**",), domain=0, format="rmw_zenoh", began_ns=0)
US = b"p" * 16


@pytest.fixture(scope="module")
def types():
    return RosTypes()


@pytest.fixture(scope="module")
def releases():
    return Releases()


def word(types: RosTypes, number: int, topic: str = "/talk", domain: int = 0) -> Sample:
    key = Published(topic, STRING, types.hash(STRING)).key(domain)
    payload = types.encode(STRING, types.make(STRING, f"word {number}"))
    return Sample(key, payload, Attachment(number, number, US).encode(), "zenoh/bytes", number * 10**9)


def written(path, samples, releases, drops=()) -> CaptureWriter:
    writer = CaptureWriter(path, BEGAN, releases)
    for sample in samples:
        writer.write(sample)
        writer.flush()
    for dropped in drops:
        writer.drop(dropped)
    return writer


def test_what_the_recorder_counted_is_counted_again_from_the_file(tmp_path, types, releases):
    path = tmp_path / "F.mcap"
    drop = Dropped.of(word(types, 6).key, Attachment(6, 6, US), 6)
    drops = [drop.with_next(Dropped.of(drop.key, Attachment(7, 7, US), 7))]
    writer = written(path, [word(types, 1), word(types, 2), word(types, 4)], releases, drops)
    writer.close("over", 9 * 10**9)
    capture = read_capture(path)
    (ours,), (theirs,) = writer.tally.senders, capture.tally.senders
    assert ours[:3] == theirs[:3] == ("/talk", drop.key, US.hex())
    assert ours.series.lost == theirs.series.lost == ((3, 3), (5, 5))
    assert ours.series.dropped == theirs.series.dropped == 2  # 6 and 7 came, and are not lost on the way
    with path.open("rb") as file:
        (content,) = [record.metadata for record in make_reader(file).iter_metadata() if record.name == END]
    assert json.loads(content["content"])["losses"] == [["/talk", US.hex(), 2, 2, 0, 0, [[3, 3], [5, 5]]]]
    assert [(one.where, one.what) for one in examine(capture)] == [
        ("/talk", "2 messages of publisher 70707070 never came: numbers 3, 5"),
        ("/talk", "2 messages of publisher 70707070 came, and the recorder had no room for them"),
    ]
    assert "3 messages" in " ".join(" ".join(summary_lines(describe(capture))).split())


def test_a_recording_without_losses_is_healthy_and_one_without_numbers_says_what_it_cannot_tell(
    tmp_path, types, releases, capsys
):
    path = tmp_path / "F.mcap"
    written(path, [word(types, 1), Sample("door", b"open", b"", "text/plain", 1)], releases).close("over", 1)
    assert main(["doctor", str(path)]) == 0
    assert "no numbers on door: what was lost of these is not known" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("hash_of", "encoding"),
    [
        (lambda types: types.hash(STRING), "ros2msg"),
        (lambda _: NO_HASH, "ros2msg"),
        (lambda _: "RIHS01_" + "0" * 64, ""),
    ],
)
def test_a_type_is_defined_if_its_hash_is_known(tmp_path, types, releases, hash_of, encoding):
    path = tmp_path / "F.mcap"
    key = Published("/talk", STRING, hash_of(types)).key(0)
    payload = word(types, 1).payload
    writer = written(path, [Sample(key, payload, b"", "zenoh/bytes", 1)], releases)
    writer.close("over", 1)
    with path.open("rb") as file:
        ((schema, channel, message),) = make_reader(file).iter_messages()
    assert schema is not None
    assert (schema.name, schema.encoding, bool(schema.data)) == (STRING, encoding, bool(encoding))
    assert (channel.topic, channel.message_encoding, message.data) == ("/talk", "cdr", payload)


def test_topics_of_another_domain_and_raw_recordings_are_kept_as_they_come(tmp_path, types, releases):
    for name, sample, forms in (("other", word(types, 1, domain=5), releases), ("raw", word(types, 1), None)):
        path = tmp_path / f"{name}.mcap"
        written(path, [sample], forms).close("over", 1)
        with path.open("rb") as file:
            ((schema, channel, message),) = make_reader(file).iter_messages()
        assert (schema, channel.topic, message.data) == (None, sample.key, sample.payload)
        assert read_capture(path).tally.senders[0].publisher == US.hex()


def test_a_damaged_chunk_is_a_loss_that_is_told(tmp_path, types, releases):
    path, mended = tmp_path / "F.mcap", tmp_path / "mended.mcap"
    written(path, [word(types, number) for number in range(1, 6)], releases).close("over", 1)
    data = bytearray(path.read_bytes())
    places = [place for place in range(len(data)) if data.startswith(b"zstd", place)]
    data[places[2] + 20] ^= 1  # in the third chunk
    path.write_bytes(data)
    capture = read_capture(path)
    assert capture.tally.senders[0].series.lost == ((3, 3),)
    told = {one.where.partition(" ")[0]: one.what for one in examine(capture)}
    assert told["end"] == "its recorder counted 0 missing messages, from the file follow 1"
    assert "byte" in told
    recovery = recover_capture(path, mended)
    assert (recovery.kept, recovery.missing, recovery.complete) == (4, 1, False)
    assert next(finding.what for finding in examine(read_capture(mended))).startswith("not complete: recovered: ")


def test_whatever_is_in_a_file_is_told_and_never_a_fault(tmp_path, types, releases):
    path = tmp_path / "F.mcap"
    drops = [Dropped(key="door", publisher="", count=3, at_ns=5)]
    written(path, [word(types, number) for number in (1, 2, 4)], releases, drops).close("over", 1)
    whole = path.read_bytes()
    chance = random.Random(1)
    read = 0
    for _ in range(300):
        data = bytearray(whole[: chance.randrange(1, len(whole) + 1)])
        for _ in range(chance.randrange(3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        if is_capture(path):
            try:
                capture = read_capture(path)
            except RecordingError as error:
                assert str(path) in str(error)
            else:
                read += 1
                summary_lines(json.loads(json.dumps(describe(capture))))
                assert bytes(data) == whole or any(one.severity is Severity.ERROR for one in examine(capture))
    assert read > 100


def test_black_images_do_not_make_a_file_that_unpacks_to_more_than_is_read(tmp_path, releases):
    path = tmp_path / "F.mcap"
    black = Sample("camera", bytes(2**22), b"", "zenoh/bytes", 1)
    written(path, [black] * 24, releases).close("over", 1)  # 96 MiB
    assert not read_capture(path).damage
    assert path.stat().st_size < 2**25


def test_a_file_that_is_there_is_not_touched(tmp_path, releases):
    path = tmp_path / "F.mcap"
    path.write_text("mine")
    with pytest.raises(RecordingError, match="the file exists"):
        CaptureWriter(path, BEGAN, releases)
    assert path.read_text() == "mine"
