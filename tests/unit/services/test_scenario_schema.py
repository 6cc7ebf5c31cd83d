"""The JSON schema that editors are given takes what dynpf takes, and refuses what it refuses."""

import json
import tomllib
from typing import Any

import pytest
from dynpf_lab.cli.main import main
from dynpf_services.scenario.load import scenario_files
from dynpf_services.scenario.vocabulary import json_schema
from jsonschema import Draft202012Validator

VALIDATOR = Draft202012Validator(json_schema())
ROOM = tomllib.loads(next(path for path in scenario_files() if path.stem == "landmark-room").read_text())


@pytest.mark.parametrize("path", scenario_files(), ids=lambda path: path.stem)
def test_a_scenario_that_comes_along_fits(path: Any) -> None:
    assert [error.message for error in VALIDATOR.iter_errors(tomllib.loads(path.read_text()))] == []


@pytest.mark.parametrize(
    "change",
    [
        {"sede": 3},
        {"tick_s": -1.0},
        {"estimator": {**ROOM["estimator"], "nn": 3}},
        {"estimator": {**ROOM["estimator"], "n": 0}},
        {"simulator": {"kind": "rom"}},
        {"estimator": {**ROOM["estimator"], "motion": "arc"}},
        {"nodes": {"other": {"kind": "rearrangement"}}},  # of two sections: rearrangement_estimator
        {"nodes": {"other": {}}},
        {"robots": "r1"},
    ],
)
def test_what_is_no_scenario_does_not(change: dict[str, Any]) -> None:
    assert not VALIDATOR.is_valid({**ROOM, **change})


@pytest.mark.parametrize(
    "change",
    [
        {"nodes": {"ekf": {"kind": "localization", "filter": "extended_kalman", "remap": {"sensors/scan": "x/scan"}}}},
        {"nodes": {"own": {"kind": "mine:Node", "anything": 3}}},
        {"estimator": {**ROOM["estimator"], "motion": "arcs", "proposal": "mine:Proposal", "adaptation": "kld"}},
        {"controller": {"kind": "mine:Controller", "speed": 1.0}},
        {"robots": ["r1"], "robot": {"estimator": {"kind": "localization"}}},
    ],
)
def test_further_nodes_robots_and_ones_own_fit(change: dict[str, Any]) -> None:
    assert [error.message for error in VALIDATOR.iter_errors({**ROOM, **change})] == []


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(json_schema()))
