"""``dynpf resume`` in one process: files cut anywhere give the undisturbed run, and what cannot go on is refused."""

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import ScenarioError, UsageError
from dynpf_runtime import snapshot
from dynpf_runtime.plan import run_header
from dynpf_runtime.source import LogRecord
from dynpf_services.recorder.host import recorded_boots
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.resume import resumable, resume_inline

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=120", "estimator.n=10"])


@pytest.fixture(name="whole", scope="module")
def a_whole_recording_with_many_chunks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("dynpf_formats.recording.writer.CHUNK_BYTES", 8192)
        patched.setattr(snapshot, "_OFTEN", 10)
        patched.setattr(snapshot, "_SENT_PER_BYTE", 0)
        patched.setattr(snapshot, "_FIRST_SENT_PER_BYTE", 0)
        record_inline(SCENARIO, path)
    return path


def cut(whole: Path, path: Path, share: float) -> Path:
    """Return the beginning of a recording."""
    data = whole.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


@pytest.mark.parametrize("share", [0.03, 0.2, 0.37, 0.5, 0.71, 0.9, 0.97, 0.9999])
def test_a_recording_that_is_cut_anywhere_becomes_that_of_the_undisturbed_run(
    share: float, whole: Path, tmp_path: Path
) -> None:
    path = cut(whole, tmp_path / "run.mcap", share)
    scenario = resumable(path, None, ())
    tick = resume_inline(path, scenario, None)
    recording = read_recording(path)
    assert recording.end is not None
    assert (recording.end.complete, recording.end.outcome) == (True, "budget spent")
    assert content_digest(recording) == content_digest(read_recording(whole))
    assert 0 <= tick < 120
    assert tick > 60 or share < 0.7  # it has not begun anew
    assert main(["doctor", str(path)]) == 0
    assert main(["replay", str(path)]) == 0
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("ticks", [1, 47, 118])
def test_a_stopped_run_goes_on_to_the_bytes_of_one_that_was_not(ticks: int, whole: Path, tmp_path: Path) -> None:
    path, asked = tmp_path / "run.mcap", itertools.count()
    record_inline(SCENARIO, path, stopped=lambda: "stopped by the user" if next(asked) >= ticks else "")
    stopped = read_recording(path)
    assert stopped.end is not None
    assert (stopped.end.complete, stopped.end.outcome) == (True, "stopped")
    assert main(["resume", str(path), "--runner", "inline", "--no-page"]) == 0
    assert content_digest(read_recording(path)) == content_digest(read_recording(whole))
    assert main(["doctor", str(path)]) == 0


def test_a_node_of_which_all_is_lost_is_known_by_who_has_read_its_messages(whole: Path, tmp_path: Path) -> None:
    recording, path = read_recording(whole), tmp_path / "run.mcap"
    with RecordingWriter(path, recording.header, recording.attachments, schemas=recording.schemas) as writer:
        for one in recording.records:
            if one.node != "controller" and one.stamp_ns < 10**9:
                envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
                writer.message(one.topic, envelope, one.payload)
        writer.close(complete=False, reason="killed")
    assert recorded_boots(path, plan_of(SCENARIO))["controller"] == "inline"
    assert main(["resume", str(path), "--runner", "inline", "--no-page"]) == 0
    assert content_digest(read_recording(path)) == content_digest(recording)


def test_what_a_person_did_in_a_tick_that_not_all_nodes_have_made_is_done_again(tmp_path: Path) -> None:
    whole, path = tmp_path / "whole.mcap", tmp_path / "run.mcap"
    carried = LogRecord("operator/place", 10**9, b'{"x":1.0,"y":-0.5,"theta":0.5}')
    record_inline(SCENARIO, whole, acts={10: [carried]})
    recording = read_recording(whole)
    with RecordingWriter(path, recording.header, recording.attachments, schemas=recording.schemas) as writer:
        for one in recording.records:
            if one.stamp_ns < 10**9 or (one.node == "simulator" and one.stamp_ns == 10**9):
                envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
                writer.message(one.topic, envelope, one.payload)
        writer.close(complete=False, reason="killed")
    assert main(["resume", str(path), "--runner", "inline", "--no-page"]) == 0
    assert content_digest(read_recording(path)) == content_digest(recording)


def test_a_stopped_run_stays_as_it_is_until_all_of_it_is_written_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, asked = tmp_path / "run.mcap", itertools.count()
    record_inline(SCENARIO, path, stopped=lambda: "stopped by the user" if next(asked) >= 20 else "")
    before, written = path.read_bytes(), itertools.count()

    def interrupted(*_: object) -> None:
        if next(written) > 50:
            raise KeyboardInterrupt

    monkeypatch.setattr(RecordingWriter, "message", interrupted)
    with pytest.raises(KeyboardInterrupt):
        resume_inline(path, resumable(path, None, ()), None)
    assert path.read_bytes() == before
    assert [*tmp_path.iterdir()] == [path]


def test_what_was_recorded_is_kept_when_the_run_cannot_go_on(whole: Path, tmp_path: Path) -> None:
    """A node of another build does something else: what the recording had stays in it."""
    path = cut(whole, tmp_path / "run.mcap", 0.6)
    before = [one for one in read_recording(path, allow_truncated=True).messages() if one.topic == "truth/robot"]
    scenario = resumable(path, None, ())
    with pytest.raises(KeyboardInterrupt):
        resume_inline(path, scenario, None, stopped=_interrupt)
    after = [one for one in read_recording(path).messages() if one.topic == "truth/robot"]
    assert [one.payload for one in after][: len(before) - 1] == [one.payload for one in before][:-1]
    resume_inline(path, scenario, None)  # and once more
    assert content_digest(read_recording(path)) == content_digest(read_recording(whole))


def _interrupt() -> str:
    raise KeyboardInterrupt


def _whole(path: Path, whole: Path) -> None:
    shutil.copy(whole, path)


def _realtime(path: Path, _whole: Path) -> None:
    scenario = load_scenario("landmark-room", clock="realtime")
    RecordingWriter(path, run_header(plan_of(scenario))).close(complete=False, reason="killed")


def _signed(path: Path, whole: Path) -> None:
    cut(whole, path, 0.5)
    path.with_name(f"{path.name}.sig").write_text("{}")


@pytest.mark.parametrize(
    ("made", "words"),
    [(_whole, "the run is whole"), (_realtime, "realtime"), (_signed, "signs the recording as it is")],
)
def test_what_cannot_be_resumed_is_refused_in_a_sentence(
    made: Callable[[Path, Path], None], words: str, whole: Path, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    made(path, whole)
    before = path.read_bytes()
    with pytest.raises(UsageError, match=words):
        resumable(path, None, ())
    assert path.read_bytes() == before


def test_a_recording_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with (
        RecordingWriter(path, run_header(plan_of(SCENARIO))),
        pytest.raises(UsageError, match="a recorder is still writing it"),
    ):
        resumable(path, None, ())


def test_code_that_the_recording_names_is_not_run_unless_it_is_allowed(whole: Path, tmp_path: Path) -> None:
    text = plan_of(SCENARIO).text.replace('"kind":"arcs"', '"kind":"evil.models:Model"')
    assert "evil" in text
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, run_header(plan_of(SCENARIO)._replace(text=text)))
    writer._file.close()
    with pytest.raises(ScenarioError, match=r"--allow-code evil\.models"):
        resumable(path, None, ())
