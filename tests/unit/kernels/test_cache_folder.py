"""The folder of compiled kernels in a place that all may write to: this user's own, or none."""

from pathlib import Path

import pytest

from dynpf.kernels.compiler import _private


def test_a_new_folder_is_private(tmp_path: Path) -> None:
    folder = tmp_path / "dynpf-0"
    assert _private(folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    assert _private(folder)


def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    folder = tmp_path / "dynpf-0"
    folder.mkdir()
    folder.chmod(0o777)
    assert not _private(folder)


def test_a_link_and_a_folder_of_somebody_else_are_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, link = tmp_path / "dynpf-0", tmp_path / "link"
    folder.mkdir(mode=0o700)
    link.symlink_to(folder)
    assert not _private(link)
    monkeypatch.setattr("dynpf.kernels.compiler.os.getuid", lambda: folder.stat().st_uid + 1)
    assert not _private(folder)
