"""One pass over a recording: what it yields, and that its memory does not grow with the number of messages."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from dynpf_formats.recording.header import RunEnd
from dynpf_formats.recording.mcap_records import Damage, End, Region
from dynpf_formats.recording.reader import load, read_recording
from dynpf_formats.recording.stream import Described, Source, StreamedMessage, stream
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.messages import RobotState

from tests.unit.recording.recorded_runs import HEADER, MAP, lockstep, write

FEW, MANY = 10_000, 60_000
GROWTH_BYTES = 2**19  # of one pass, from FEW to MANY messages
INDEX_BYTES = 75  # a message, of the index, at the most while it is sorted


def test_the_stream_yields_everything_in_the_order_of_the_file(tmp_path: Path) -> None:
    sent = lockstep(6)
    items = list(stream(write(tmp_path / "run.mcap", sent, flush_every=10)))
    assert items[:2] == [HEADER, MAP]
    assert isinstance(items[2], Region)
    assert isinstance(items[-1], End)
    assert [type(item) for item in items].count(RunEnd) == 1
    messages = [item for item in items if isinstance(item, StreamedMessage)]
    assert [(one.source, one.sequence, one.stamp_ns, one.publish_ns, one.payload) for one in messages] == [
        (Source(topic, place.node, place.boot), place.sequence, place.stamp_ns, place.publish_ns, payload)
        for topic, place, payload in sent
    ]
    described = [item for item in items if isinstance(item, Described)]
    assert len(described) == len({one.channel for one in described}) == len({one.source for one in messages})


def test_a_channel_whose_description_is_lost_is_described_at_the_end(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", lockstep(6), flush_every=7)
    data = bytearray(path.read_bytes())
    first = next(item for item in stream(path) if isinstance(item, Region))
    data[first.offset + first.length - 20] ^= 1
    path.write_bytes(data)
    items = list(stream(path))
    messages = [place for place, item in enumerate(items) if isinstance(item, StreamedMessage)]
    assert len(messages) == 35
    assert {item.source for item in items if isinstance(item, StreamedMessage)} == {None}
    described = [place for place, item in enumerate(items) if isinstance(item, Described)]
    assert min(described) > max(messages)
    assert [type(item) for item in items].count(Damage) == 1
    assert [record.sequence for record in load(path).recording.messages("truth/robot")] == [1, 2, 3, 4, 5]


@pytest.fixture(scope="module")
def long_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("long")
    payload = encode("truth/robot", RobotState(x=0.5, y=0.25, theta=0.1))
    paths = {count: folder / f"{count}.mcap" for count in (FEW, MANY)}
    for count, path in paths.items():
        with RecordingWriter(path, HEADER) as writer:
            for sequence in range(count):
                envelope = Envelope("simulator", "simulator-b1", sequence, sequence, sequence * 1000, sequence)
                writer.message("truth/robot", envelope, payload)
            writer.close(complete=True, reason="finished")
    return paths


def growth(paths: dict[int, Path], read: Callable[[Path], object]) -> int:
    """Return by how much more bytes the larger file takes at the most."""
    peaks = []
    for count in (FEW, MANY):
        tracemalloc.start()
        try:
            kept = read(paths[count])
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        del kept
    return peaks[1] - peaks[0]


def counted(path: Path) -> int:
    return sum(isinstance(item, StreamedMessage) for item in stream(path))


def test_memory_of_one_pass_does_not_grow_with_the_messages(long_runs: dict[int, Path]) -> None:
    assert {count: counted(path) for count, path in long_runs.items()} == {count: count for count in long_runs}
    assert growth(long_runs, counted) < GROWTH_BYTES
    assert growth(long_runs, lambda path: list(stream(path))) > 20 * GROWTH_BYTES  # the control


def test_the_index_takes_some_tens_of_bytes_a_message(
    long_runs: dict[int, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dynpf_formats.recording.index._CACHE_BYTES", 2**20)
    assert growth(long_runs, read_recording) < INDEX_BYTES * (MANY - FEW)
    assert growth(long_runs, lambda path: list(read_recording(path).records)) > INDEX_BYTES * (MANY - FEW)
