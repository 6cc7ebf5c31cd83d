"""Where the recorder of a container records that is started again: into its file, unless that is of an earlier run."""

import argparse
import os
import socket
from pathlib import Path

from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.service import recorder_output
from dynpf_runtime.plan import run_header
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

HEADER = run_header(plan_of(load_scenario("landmark-room")))


def output(folder: Path) -> str:
    options = argparse.Namespace(output=folder / "run-{host}.mcap", patience=30.0, scenario="landmark-room")
    return recorder_output(options, 1).name


def test_it_goes_on_with_its_file_and_leaves_those_of_earlier_runs(tmp_path: Path) -> None:
    first, second, third = (f"run-{socket.gethostname()}{number}.mcap" for number in ("", "-2", "-3"))
    assert output(tmp_path) == first
    with RecordingWriter(tmp_path / first, HEADER) as writer:
        assert output(tmp_path) == first, "its recorder was killed a moment ago"
        writer.close(complete=False, reason="estimator is gone")
    assert output(tmp_path) == second, "that run has broken off"
    (tmp_path / second).write_bytes((tmp_path / first).read_bytes()[:-400])
    assert output(tmp_path) == second
    os.utime(tmp_path / second, (0, 0))
    assert output(tmp_path) == third, "nobody has waited for so long"
