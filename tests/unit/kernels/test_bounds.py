"""Kernels that check every index, for states that may be anybody's work."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from dynpf_lab.cli.main import main

BEYOND = """
import numpy as np
from dynpf.kernels.compiler import cache_folder, kernel

@kernel
def at(values, index):
    return values[index]

print(cache_folder().name.endswith("-bounds"))
print(at(np.zeros(3), 1))
at(np.zeros(3), 10**6)
"""


@pytest.mark.parametrize("checked", [False, True])
def test_no_index_leads_out_of_an_array_where_bounds_are_checked(checked: bool, tmp_path: Path) -> None:
    script = tmp_path / "beyond.py"
    script.write_text(BEYOND.replace("10**6", "10**6" if checked else "2"))
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": str(int(checked)), "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment, check=False)
    assert done.stdout.split() == [str(checked), "0.0"], done.stderr
    assert ("IndexError" in done.stderr) is checked


def test_replaying_from_a_snapshot_checks_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_BOUNDSCHECK", "0")
    for option, checked in (("--until", "0"), ("--from", "1")):
        assert main(["replay", "nothing.mcap", option, "1s"]) == 2
        assert os.environ["NUMBA_BOUNDSCHECK"] == checked
