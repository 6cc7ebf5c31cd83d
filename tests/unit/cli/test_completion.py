"""Tab completion: the shell hands a line over in variables, and finds what may come next in a file."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from dynpf_experiments.catalogue import study_names


def completed(line: str, folder: Path) -> list[str]:
    told = folder / "told"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(told),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    command = [sys.executable, "-m", "dynpf_lab.cli.main"]
    subprocess.run(command, env={**os.environ, **asked}, cwd=folder, check=True, timeout=60, capture_output=True)
    return [word.strip() for word in told.read_text().splitlines()]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("dynpf re", ["record", "replay", "resume", "recover", "references"]),
        ("dynpf run --runner ", ["bus", "inline"]),
        ("dynpf study colon-", [name for name in study_names() if name.startswith("colon-")]),
    ],
)
def test_a_line_is_completed_by_what_the_command_takes(line: str, words: list[str], tmp_path: Path) -> None:
    assert completed(line, tmp_path) == words


def test_a_scenario_is_completed_by_the_shipped_ones_and_by_files(tmp_path: Path) -> None:
    (tmp_path / "landing.toml").touch()
    (tmp_path / "land.csv").touch()
    assert set(completed("dynpf run land", tmp_path)) == {
        *("landmark-filters", "landmark-mrclam", "landmark-room", "landmark-team"),
        "landing.toml",
    }
