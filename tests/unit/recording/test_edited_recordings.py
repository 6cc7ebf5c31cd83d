"""Whatever is edited in a recording with every checksum made right is found, or told as not compared."""

from random import Random

import pytest
from dynpf_formats.recording.doctor import examine

from checks.edits.content import Content, resealed, write_content
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
