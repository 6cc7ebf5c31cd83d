"""The content digest is what the documentation says: a program with the mcap package alone computes it, too."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from dynpf_formats.recording.diff import diff
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.errors import CorruptRecordingError
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.recording.stream import Source
from dynpf_protocol.journal import Consumed, JournalEntry, Produced, decode_entry, encode_entry
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.unit.recording.recorded_runs import Sent, changed, lockstep, write

PAGE = Path(__file__).parents[3] / "docs" / "recording.md"


@pytest.fixture
def by_another_tool(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[Path], str]:
    """Return the digest as the program on the documentation's page prints it."""
    _, program = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)

    def digest(path: Path) -> str:
        shutil.copyfile(path, tmp_path / "run.mcap")
        monkeypatch.chdir(tmp_path)
        exec(compile(program, PAGE.name, "exec"), {})
        return capsys.readouterr().out.strip()

    return digest


def restarted() -> list[Sent]:
    """A run in which every process started twice."""
    return [*lockstep(4), *lockstep(3, boot="b2")]


def without_journal() -> list[Sent]:
    return [one for one in lockstep(4) if not one.topic.startswith("journal/")]


def holed() -> list[Sent]:
    return changed(changed(lockstep(6), "truth/robot", 2, lambda _: None), "journal/sensors", 0, lambda _: None)


@pytest.mark.parametrize("sent", [lockstep(6), restarted(), without_journal(), holed()])
def test_another_tool_computes_the_same_digest(
    sent: list[Sent], tmp_path: Path, by_another_tool: Callable[[Path], str]
) -> None:
    path = write(tmp_path / "a.mcap", sent, flush_every=5)
    assert content_digest(read_recording(path)) == by_another_tool(path)
    other = write(tmp_path / "b.mcap", sent[:-2])
    assert content_digest(read_recording(other)) == by_another_tool(other) != by_another_tool(path)


@settings(
    derandomize=True,
    deadline=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_messages_that_are_late_or_come_twice_change_nothing(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory, by_another_tool: Callable[[Path], str]
) -> None:
    sent = lockstep(3)
    mixed = data.draw(st.permutations(sent))
    mixed += data.draw(st.lists(st.sampled_from(sent), max_size=4))
    folder = tmp_path_factory.mktemp("runs")
    found = write(folder / "mixed.mcap", mixed, flush_every=data.draw(st.integers(0, 5)))
    digest = content_digest(read_recording(found))
    assert digest == content_digest(read_recording(write(folder / "sorted.mcap", sent)))
    assert digest == by_another_tool(found)


def test_of_a_number_that_stands_for_two_messages_the_first_counts(tmp_path: Path) -> None:
    sent = lockstep(3)
    other = changed(sent, "truth/robot", 1, lambda one: one._replace(payload=one.payload.replace(b"0.5", b"0.7")))
    again = next(one for one in other if one.topic == "truth/robot" and one.envelope.sequence == 1)
    digest = content_digest(read_recording(write(tmp_path / "a.mcap", sent)))
    assert content_digest(read_recording(write(tmp_path / "b.mcap", [*sent, again]))) == digest
    assert content_digest(read_recording(write(tmp_path / "c.mcap", [again, *sent]))) != digest


def test_a_file_in_order_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Source] = []
    sorted_of = Recording.of

    def of(recording: Recording, source: Source) -> object:
        read.append(source)
        return sorted_of(recording, source)

    monkeypatch.setattr(Recording, "of", of)
    content_digest(read_recording(write(tmp_path / "a.mcap", holed(), flush_every=5)))
    assert read == []
    late, *sent = [one for one in lockstep(4) if one.topic == "truth/robot"]
    content_digest(read_recording(write(tmp_path / "b.mcap", [*sent, late])))
    assert read == [Source("truth/robot", "simulator", "simulator-b1")]


REFERENCE = st.tuples(st.sampled_from(["truth/robot", "diagnostics", "event/estimator"]), st.integers(0, 2))
ENTRIES = st.builds(
    JournalEntry,
    step=st.integers(0, 2),
    tick=st.integers(0, 2),
    stamp_ns=st.sampled_from([0, 50_000_000]),
    consumed=st.lists(REFERENCE.map(lambda one: Consumed("simulator", "simulator-b1", *one)), max_size=2).map(tuple),
    produced=st.lists(REFERENCE.map(lambda one: Produced(*one)), max_size=2).map(tuple),
    state=st.sampled_from(["", "a" * 64]),
)


@settings(derandomize=True, deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(a=ENTRIES, b=ENTRIES)
def test_whatever_differs_in_a_step_diff_and_digest_agree(
    a: JournalEntry, b: JournalEntry, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("runs")
    sent = lockstep(2)

    def recorded(number: int, entry: JournalEntry) -> Recording:
        told = changed(sent, "journal/sensors", 1, lambda one: one._replace(payload=encode_entry(entry)))
        return read_recording(write(folder / f"{number}.mcap", told))

    left, right = (recorded(number, entry) for number, entry in enumerate((a, b)))
    difference = diff(left, right)
    assert difference.same == (content_digest(left) == content_digest(right))
    assert difference.same or difference.first is not None


def test_what_a_step_produced_in_another_order_is_named(tmp_path: Path) -> None:
    def run(*topics: str) -> Recording:
        def change(one: Sent) -> Sent:
            made = tuple(Produced(topic, 1) for topic in topics)
            return one._replace(payload=encode_entry(msgspec.structs.replace(decode_entry(one.payload), produced=made)))

        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
        return read_recording(write(path, changed(lockstep(2), "journal/estimator", 1, change)))

    first = diff(run("estimator/state", "guard/alarm"), run("guard/alarm", "estimator/state")).first
    assert first is not None
    assert (first.topic, first.tick, first.sequence, first.field) == ("journal/estimator", 1, 1, "produced[0]")
    assert (first.a, first.b) == ("estimator/state 1", "guard/alarm 1")


@pytest.mark.parametrize("payload", [b"{}", b"\xff", b'{"step":0,"tick":1' + b"0" * 30 + b"}"])
def test_what_should_be_a_step_and_is_none_is_refused(
    payload: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dynpf_formats.recording.writer._entry", lambda *_: None)
    sent = changed(lockstep(2), "journal/sensors", 1, lambda one: one._replace(payload=payload))
    recording = read_recording(write(tmp_path / "run.mcap", sent))
    with pytest.raises(CorruptRecordingError, match=r"run\.mcap: journal of sensors, entry 1: "):
        content_digest(recording)
