"""Packages of a user's own, whose names are those of dynpf's folders, are in nobody's way."""

import json
from pathlib import Path

from tests.integration.conftest import Start

NAMES = ("services", "protocol", "formats", "runtime", "lab", "scenarios", "numpy_utils")


def test_a_run_does_not_see_folders_of_a_user_that_are_called_as_its_own(
    tmp_path: Path, dynpf: Start, monkeypatch
) -> None:
    mine = tmp_path / "mine"
    for name in NAMES:
        (mine / name).mkdir(parents=True)
        (mine / name / "__init__.py").write_text("raise RuntimeError('mine')\n")
    monkeypatch.chdir(mine)
    run = dynpf("run", "landmark-room", "--set", "max_ticks=2", "--json", "-o", tmp_path / "run.mcap", modules=mine)
    assert run.wait() == 0, run.stderr
    assert json.loads(run.stdout)["complete"]
