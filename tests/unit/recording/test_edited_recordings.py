"""Whatever is edited in a recording with every checksum made right is found, or told as not compared."""

from random import Random

import pytest
from dynpf_formats.recording.doctor import altered, diagnose, examine
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.recover import recover
from dynpf_protocol.journal import encode_entry
from msgspec.structs import replace

from checks.edits.content import Content, entry_of, replaced, resealed, write_content
from checks.edits.judge import Found, Judge, Level
from checks.edits.kinds import KINDS, Kind
from checks.edits.runs import small_runs


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Content]:
    return [*small_runs(tmp_path_factory.mktemp("runs"))]


def test_unedited_runs_are_whole_and_sealed_as_they_were(runs, tmp_path):
    """The control: writing a run again, chained and sealed anew, changes nothing and is no fault."""
    for run in runs:
        assert resealed(run) == run
        write_content(run, tmp_path / "copy.mcap")
        assert examine(tmp_path / "copy.mcap") == []


@pytest.fixture(scope="module")
def judge(tmp_path_factory) -> Judge:
    return Judge(tmp_path_factory.mktemp("edited"))


@pytest.mark.parametrize("level", Level)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_an_edit_is_found(kind: Kind, level: Level, runs: list[Content], judge: Judge) -> None:
    random = Random(f"{kind.name} {level}")
    attempts = (judge.judge(kind, random.choice(runs), random, level) for _ in range(100))
    judged = next(attempt for attempt in attempts if attempt is not None)
    assert judged.found is not Found.SILENT
    if level is Level.CHECKSUMS:
        assert judged.found is Found.DOCTOR or kind.what == "not compared"


def test_half_a_run_with_its_end_kept_is_found_and_told(runs, tmp_path):
    (kind,) = [kind for kind in KINDS if kind.name == "ticks cut off"]
    cut = kind.change(runs[0], Random(1))
    assert cut is not None
    write_content(resealed(cut), tmp_path / "cut.mcap")
    told = " ".join(finding.what for finding in examine(tmp_path / "cut.mcap"))
    assert "which is not its last" in told


@pytest.mark.parametrize(
    ("name", "what"),
    [("message repeated", "were recorded twice"), ("reason of the end altered", "not what its recorder sealed")],
)
def test_recovery_does_not_make_an_altered_run_a_complete_one(name, what, runs, tmp_path):
    (kind,) = [kind for kind in KINDS if kind.name == name]
    changed = kind.change(runs[0], Random(1))
    assert changed is not None
    write_content(changed, tmp_path / "edited.mcap")
    found = altered(read_recording(tmp_path / "edited.mcap"))
    assert found
    assert diagnose(tmp_path / "edited.mcap").altered == tuple(found)
    recovered = recover(tmp_path / "edited.mcap", tmp_path / "recovered.mcap")
    assert not recovered.complete
    assert what in recovered.reason
    mended = read_recording(tmp_path / "recovered.mcap")
    assert len(mended.records) == len(runs[0].rows)
    write_content(runs[0], tmp_path / "true.mcap")
    assert recover(tmp_path / "true.mcap", tmp_path / "copy.mcap").complete  # the control


def test_a_log_played_in_another_order_within_a_tick_is_no_run_of_it(runs, judge):
    """The record that begins a tick ends what belongs to it."""
    _, played, _ = runs

    def reversed_records(content: Content, _random: Random) -> Content | None:
        index, row, entry = next(
            (index, row, entry)
            for index, row in enumerate(content.rows)
            if (entry := entry_of(row)) is not None and len(entry.hosted) > 1
        )
        changed = replace(entry, hosted=entry.hosted[::-1])
        return content._replace(rows=replaced(content.rows, index, row._replace(payload=encode_entry(changed))))

    kind = Kind("log reversed", "journal", reversed_records)
    judged = judge.judge(kind, played, Random(1), Level.SEAL)
    assert judged is not None
    assert judged.found is Found.REPLAY
