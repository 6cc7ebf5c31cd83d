"""``dynpf sim``: schedules are played, told, and shrunk when they fail."""

import json

import pytest
from dynpf_lab.cli.main import main

from tests.unit.simulation.planted_bugs import BUGS

SIM = ["sim", "landmark-room", "--set", "max_ticks=5"]


def test_schedules_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SIM, "--schedules", "5", "--jobs", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["schedules"], document["failures"], document["broken"]) == (5, 0, [])
    assert 0 < document["whole"] <= 5


def test_a_schedule_is_told_as_a_timeline(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SIM, "--seed", "1", "--schedule", "5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("schedule 5 of seed 1: ")
    times = [float(line.split(" s  ")[0]) for line in lines if " s  " in line]
    assert times == sorted(times)
    assert len(times) > 10
    assert sum("  fault  " in line for line in lines) >= 1
    assert lines[-1] in ("the run is whole", "the run is incomplete, and that is known")


def test_a_failure_is_shrunk_and_its_command_fails_again(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    BUGS["a swallowed duplicate"](monkeypatch)
    assert main([*SIM[:2], "--set", "max_ticks=10", "--schedules", "17", "--jobs", "1"]) == 1
    out = capsys.readouterr().out
    again = next(line for line in out.splitlines() if line.startswith("again: dynpf sim "))
    assert main(again.removeprefix("again: dynpf ").split()) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("BROKEN: ")


def test_faults_are_those_of_a_schedule(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SIM, "--faults", "0"]) == 2
    assert "name it with --schedule" in capsys.readouterr().err
    assert main([*SIM, "--schedule", "5", "--faults", "99"]) == 2
    assert "schedule 5 has" in capsys.readouterr().err
