"""What if: a branch without a change is the run itself, and with one it differs from its first tick on, not before."""

import json
from pathlib import Path

import pytest
from dynpf_formats.recording.diff import diff
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.doctor import examine
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.branch import branch_run, exchange
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.replay_part import moment_of
from dynpf_services.scenario.user_code import add_folders

from tests.replay.laser_log import laser_log

EXAMPLES = Path(__file__).parents[2] / "examples"
LATE = "faults=[{topic='sensors/odometry', to='estimator', loss=0.1, delay_s=0.1, jitter_s=0.4}]"
TICKS = 150


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    record_inline(load_scenario("landmark-room", overrides=[f"max_ticks={TICKS}", "estimator.n=30", LATE]), path)
    return path


def branched(run: Path, at: str, *overrides: str, path: Path) -> Path:
    branch_run(read_recording(run), moment_of(at), overrides, (), path)
    return path


@pytest.mark.parametrize("at", ["tick:1", "tick:60", "tick:100", "tick:140", f"tick:{TICKS - 1}", "9.95s"])
def test_a_branch_without_a_change_is_the_run_itself(run: Path, at: str, tmp_path: Path) -> None:
    path = branched(run, at, "estimator.n=30", path=tmp_path / "same.mcap")
    assert content_digest(read_recording(path)) == content_digest(read_recording(run))
    assert examine(path) == []


def test_a_log_is_played_on_from_where_it_was(tmp_path: Path) -> None:
    log = laser_log(tmp_path)
    record_inline(load_scenario("laser-log", log=log.facts), tmp_path / "run.mcap", log)
    path = branched(tmp_path / "run.mcap", "tick:9", "estimator.n=1000", path=tmp_path / "same.mcap")
    assert content_digest(read_recording(path)) == content_digest(read_recording(tmp_path / "run.mcap"))
    assert examine(path) == []


@pytest.mark.parametrize(
    ("override", "node"),
    [("estimator.n=60", "estimator"), ("sensors.odometry.w_bias=0.2", "sensors"), ("seed=2", None)],
)
def test_a_change_begins_at_its_tick_and_not_before(run: Path, override: str, node: str | None, tmp_path: Path) -> None:
    path = branched(run, "tick:120", override, path=tmp_path / "other.mcap")
    found = diff(read_recording(run), read_recording(path))
    assert found.first is not None
    assert found.first.tick is not None
    assert 120 <= found.first.tick < 125
    assert node in (None, found.first.node)
    assert found.counts["truth/robot"].b == TICKS
    assert examine(path) == []


def test_a_node_of_ones_own_takes_the_place_of_another_if_its_code_is_allowed(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add_folders([EXAMPLES / "controller"])
    words = ["replay", str(run), "--at", "tick:120", "--node", "controller=pursuit:Pursuit"]
    points = ["--set", "controller.points=[[1.5, -1.2], [2.0, 0.0]]"]
    assert main([*words, *points]) == 2
    assert "--allow-code pursuit" in capsys.readouterr().err
    assert main([*words, *points, "--allow-code", "pursuit", "--json", "-o", str(tmp_path / "other.mcap")]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["at"], told["changed"], told["fresh"]) == (120, ["controller"], ["controller"])
    assert told["first"]["tick"] >= 120
    row = told["metrics"]["position_rmse_m"]
    change = 100 * (row["after"] - row["before"]) / row["before"]
    assert row["change_percent"] == pytest.approx(change, abs=1e-3)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--at", "10s"], "say what changes there"),
        (["--at", "10s", "--set", "tick_s=0.2"], "cannot change in mid-run"),
        (["--at", "10s", "--set", "clock=realtime"], "only a lockstep run can be branched"),
        (["--at", "100s", "--set", "seed=3"], "the run has ended before that moment"),
        (["--at", "0s", "--set", "seed=3"], "nothing to branch"),
        (
            ["--at", "10s", "--set", "nodes.other={kind='waypoints', points=[[0.0, 0.0]]}"],
            "a branch has the nodes of the run",
        ),
        (["--at", "10s", "--from", "1s", "--set", "seed=3"], "goes without --from and --until"),
        (["--at", "10s", "--node", "estimator"], "expected a node and a class of yours"),
    ],
)
def test_what_cannot_be_branched_is_told(
    run: Path, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(run), *words]) == 2
    assert told in capsys.readouterr().err


def test_a_person_reads_a_table(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(run), "--at", "12s", "--set", "estimator.n=60"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "from tick 120 on with estimator.n=60"
    assert lines[1].startswith("first difference: tick 12")
    assert lines[2].split() == ["before", "after", "change"]
    assert any(line.startswith("Position RMSE") and line.endswith("%") for line in lines[3:])


def test_an_exchange_is_a_setting() -> None:
    assert exchange("estimator=mylab:Mine") == 'estimator={kind="mylab:Mine"}'
    with pytest.raises(UsageError, match="such as estimator=mylab:Mine"):
        exchange("estimator=")
