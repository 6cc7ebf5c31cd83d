"""The folder of a run: it goes with the run, and with the next one if the run was killed."""

import tempfile
from pathlib import Path

import pytest
from dynpf_runtime.bus.run_folder import run_folder


@pytest.fixture(name="parent")
def temporary_files_lie_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_nobody_else_may_read_it_and_it_is_gone_after_the_run(parent: Path) -> None:
    with run_folder() as folder:
        assert folder.parent == parent
        assert folder.stat().st_mode & 0o777 == 0o700
    assert list(parent.iterdir()) == []


def test_the_next_run_removes_what_a_killed_run_left_and_nothing_else(parent: Path) -> None:
    killed, other, cache = parent / "dynpf-killed", parent / "another-program", parent / "dynpf-1000"
    for folder in (killed, other, cache):
        folder.mkdir(mode=0o700)
    for folder in (killed, other):
        (folder / "in-use").touch()
    with run_folder() as running, run_folder() as second:
        assert {*parent.iterdir()} == {other, cache, running, second}
