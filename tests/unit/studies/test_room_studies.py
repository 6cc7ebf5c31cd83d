"""``dynpf study indoor`` and ``turtlebot`` on few trials, and what they are made of."""

import json
import math
from typing import Any

import numpy as np
import pytest
from dynpf_experiments.study import run_study, settings_from
from dynpf_lab.cli.main import main
from dynpf_systems.rooms.studies.indoor import IndoorSettings, fitted
from dynpf_systems.rooms.studies.turtlebot import STUDY
from dynpf_systems.rooms.studies.ways import dead_reckoning, load_world, measures, record


def rows_of(capsys: pytest.CaptureFixture[str], *words: str) -> list[dict[str, Any]]:
    assert main(["study", *words, "--jobs", "1", "--json"]) == 0
    return list(json.loads(capsys.readouterr().out)["rows"])


def one(rows: list[dict[str, Any]], **factors: object) -> dict[str, Any]:
    (row,) = [row for row in rows if all(row[name] == value for name, value in factors.items())]
    return row


def test_indoor_tells_success_by_start_filter_and_number(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--trials", "2", "--set", "n=[300]", "--set", "updates=25", "--set", "n_deprived=300")
    rows = rows_of(capsys, "indoor", *words)
    known = one(rows, case="drive", start="known", filter="careful")
    assert known["success_percent"] == 100.0
    assert known["position_rmse_m_mean"] < 0.1
    assert one(rows, filter="kld")["particles_mean"] <= 300
    wrong = one(rows, case="wrong", filter="resetting")
    assert wrong["success_percent"] > one(rows, case="wrong", filter="careful")["success_percent"]


def test_the_beam_model_is_fitted_to_what_was_seen() -> None:
    # People and doors are seldom in the way; the sensor's own error is 0.02 m, half a cell of the map besides.
    fit = fitted(IndoorSettings(updates=20))
    assert fit.converged
    assert fit.params.z_hit > 0.8
    assert 0.02 < fit.params.sigma_hit < 0.08


def test_turtlebot_gives_the_same_rows_on_one_process_and_on_two() -> None:
    study = STUDY
    chosen = ["worlds=['turtlebot-room']", "n=[100]", "updates=20", "loops=40", "n_panels=100"]
    settings = settings_from(study.settings, chosen)
    rows = run_study(study, settings, 2, 1, 1)
    assert run_study(study, settings, 2, 1, 2) == rows
    assert one(rows, case="drive", start="known", filter="careful")["success_percent"] == 100.0
    wheels, gyro = (one(rows, case="odometry", filter=name) for name in ("wheels", "gyro"))
    assert gyro["heading_rmse_rad_mean"] < wheels["heading_rmse_rad_mean"]


def test_another_seed_drives_elsewhere_and_odometry_goes_the_same_way() -> None:
    world = load_world("turtlebot-room")
    first, again, other = (record(world, seed, 12).epochs for seed in (1, 1, 2))
    assert all(np.array_equal(a.truth, b.truth) for a, b in zip(first, again, strict=True))
    assert math.dist(first[0].truth[:2], other[0].truth[:2]) > 0.05
    truth = np.stack([epoch.truth for epoch in first], axis=1)
    assert np.abs(dead_reckoning(first)[:2] - truth[:2]).max() < 0.1


def test_success_is_to_be_right_at_the_end_and_errors_count_from_convergence() -> None:
    epochs = record(load_world("turtlebot-room"), 1, 30).epochs
    truth = np.stack([epoch.truth for epoch in epochs], axis=1)
    late = truth.copy()
    late[0, :8] += 2.0
    found = measures(epochs, late)
    assert found == {
        "success_percent": True,
        "position_rmse_m": 0.0,
        "heading_rmse_rad": 0.0,
        "updates_to_converge": 9.0,
    }
    assert measures(epochs, late, whole=True)["position_rmse_m"] == pytest.approx(2.0 * math.sqrt(8 / 30))
    turned = truth.copy()
    turned[2, -1] += 0.3
    assert measures(epochs, turned)["success_percent"] is False
