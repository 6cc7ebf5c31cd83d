"""``dynpf replay --set``: the same inputs with another setting, for one node or for the whole run."""

import json
from pathlib import Path
from typing import Any

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    assert main(["run", "landmark-room", "--runner", "inline", "--set", "max_ticks=60", "-o", str(path)]) == 0
    return str(path)


def replay(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = main(["replay", *arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_one_node_with_another_setting_changes_that_node_alone(recorded, capsys):
    code, found = replay(capsys, recorded, "--node", "estimator", "--set", "estimator.n=50")
    assert code == 1
    assert (found["first"]["node"], found["first"]["tick"]) == ("estimator", 0)
    changed = {topic for topic, count in found["counts"].items() if count["differ"]}
    assert "estimator/state" in changed
    assert all(topic.startswith("estimator/") for topic in changed)
    assert "position_rmse_m" in found["metrics"]


def test_the_whole_run_anew_changes_what_follows_too(recorded, capsys):
    code, found = replay(capsys, recorded, "--set", "estimator.n=50")
    assert code == 1
    assert found["counts"]["controller/command"]["differ"] > 0
    assert found["counts"]["truth/robot"]["differ"] > 0


@pytest.mark.parametrize("node", [["--node", "estimator"], []])
def test_the_setting_that_it_had_changes_nothing(recorded, capsys, node):
    code, found = replay(capsys, recorded, *node, "--set", "estimator.n=500")
    assert (code, found["same"], found["first"]) == (0, True, None)


def test_a_setting_of_another_node_is_refused_for_one_that_is_replayed_by_itself(recorded, capsys):
    assert main(["replay", recorded, "--node", "controller", "--set", "estimator.n=50"]) == 2
    assert "a setting of estimator does not reach controller" in capsys.readouterr().err


def test_the_changed_run_is_kept_where_asked(recorded, capsys, tmp_path: Path):
    path = tmp_path / "new.mcap"
    replay(capsys, recorded, "--node", "estimator", "--set", "estimator.n=50", "-o", str(path))
    scenario = json.loads(read_recording(path).header.scenario)
    assert scenario["estimator"]["n"] == 50
    assert main(["replay", str(path), "--node", "estimator"]) == 0
    assert main(["replay", recorded, "-o", str(path)]) == 2
    assert "exists" in capsys.readouterr().err
