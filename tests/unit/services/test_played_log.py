"""What an imported log brings to a run: the start at its first record, its map."""

import math
from pathlib import Path
from typing import Any

import pytest
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog

from tests.unit.services.small_log import IMAGE, YAML

# It drove 1 m ahead and turned left before it was first known to be at (5, 5), facing along y.
LOG = """\
ODOM 0 0 0 0 0 0 1.0 h 1.0
ODOM 1 0 1.5707963267948966 0 0 0 2.0 h 2.0
TRUEPOS 5 5 1.5707963267948966 0 0 0 2.0 h 2.0
FLASER 2 1 70 1 0 1.5707963267948966 1 0 1.5707963267948966 2.0 h 2.0
"""
SCENARIO = """\
title = "A log"
needs_log = true
[sensors]
kind = "log"
[estimator]
kind = "localization"
start = { kind = "known" }
[[estimator.measurement]]
kind = "likelihood_field"
"""


@pytest.fixture(name="log")
def imported(tmp_path: Path) -> PlayedLog:
    (tmp_path / "log.txt").write_text(LOG)
    (tmp_path / "house.yaml").write_bytes(YAML)
    (tmp_path / "house.pgm").write_bytes(IMAGE)
    words = ["import", "carmen", str(tmp_path / "log.txt"), "--range-max", "60", "--map", str(tmp_path / "house.yaml")]
    assert main([*words, "-o", str(tmp_path / "log.mcap")]) == 0
    return PlayedLog(tmp_path / "log.mcap")


def scenario_of(tmp_path: Path, log: PlayedLog, *overrides: str, text: str = SCENARIO) -> Any:
    (tmp_path / "run.toml").write_text(text)
    return load_scenario(str(tmp_path / "run.toml"), overrides=overrides, log=log.facts)


def test_the_start_is_where_the_robot_was_at_the_first_record(log: PlayedLog) -> None:
    assert log.facts.starts[""] == pytest.approx((4.0, 5.0, 0.0))


def test_map_and_start_come_from_the_log(log: PlayedLog, tmp_path: Path) -> None:
    for name in ("house.yaml", "house.pgm"):
        (tmp_path / name).unlink()
    scenario = scenario_of(tmp_path, log)
    assert scenario.map.file == "house.yaml"
    assert scenario.files["house.yaml"].data == YAML
    assert (scenario.estimator.start.x, scenario.estimator.start.theta) == pytest.approx((4.0, 0.0))


def test_a_map_of_the_scenario_s_own_stands_against_the_log_s(log: PlayedLog, tmp_path: Path) -> None:
    own = SCENARIO + '[map]\nkind = "occupancy"\nfile = "other.yaml"\n'
    with pytest.raises(ScenarioError, match=r"'other.yaml' cannot be read: No such file"):
        scenario_of(tmp_path, log, text=own)
    (tmp_path / "other.yaml").write_bytes(YAML.replace(b"0.5", b"0.25"))
    assert scenario_of(tmp_path, log, text=own).map.file == "other.yaml"


def test_without_odometry_the_start_is_the_first_reference(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("".join(line + "\n" for line in LOG.splitlines() if "ODOM" not in line))
    assert main(["import", "carmen", str(tmp_path / "log.txt"), "-o", str(tmp_path / "log.mcap")]) == 0
    assert PlayedLog(tmp_path / "log.mcap").facts.starts[""] == pytest.approx((5.0, 5.0, math.pi / 2))
