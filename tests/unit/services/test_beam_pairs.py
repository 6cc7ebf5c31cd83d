"""``dynpf fit``: the beam model of a recorded run, found again in its ranges."""

import json
import tomllib
from pathlib import Path

import pytest
from dynpf_lab.cli.main import main
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline


def recorded(name: str, path: Path, *overrides: str) -> Path:
    resolved = load_scenario(name, overrides=overrides)
    record_inline(resolved, path)
    return path


def test_the_fit_finds_the_scanner_of_the_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Cells of 2 cm, so that their size hides little of the scanner's noise; nobody about, and doors open.
    settings = (
        "max_ticks=60",
        "map.resolution=0.02",
        "sensors.scan.range_std=0.1",
        "simulator.doors=[]",
        "estimator.n=50",
    )
    path = recorded("indoor-tracking", tmp_path / "run.mcap", *settings, "simulator.people.number=0")
    assert main(["fit", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["converged"]
    assert told["sigma_hit"] == pytest.approx(0.1, rel=0.1)
    assert told["z_hit"] > 0.97
    assert told["max_beams"] == 30  # kept from the run's estimator
    assert main(["fit", str(path)]) == 0
    table = tomllib.loads(capsys.readouterr().out)["estimator"]["measurement"][0]
    assert load_scenario("indoor-tracking", overrides=[f"estimator.measurement={_inline(table)}"])


def _inline(table: dict[str, object]) -> str:
    return "{" + ", ".join(f"{name} = {json.dumps(value)}" for name, value in table.items()) + "}"


def test_a_run_without_scans_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded("room-lines", tmp_path / "run.mcap", "max_ticks=3")
    assert main(["fit", str(path)]) == 2
    assert "holds no scans with true poses" in capsys.readouterr().err
