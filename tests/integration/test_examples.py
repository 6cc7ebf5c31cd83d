"""The examples run on the bus, inline and in a replay with the same bytes; what is beside them breaks nothing."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

DYNPF = Path(sys.executable).with_name("dynpf")
EXAMPLES = Path(__file__).parents[2] / "examples"
SYSTEMS = {"uwb": "uwb", "controller": "pursuit", "estimator": "pull"}
"""The folders of systems, and the module that each brings."""


def dynpf(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [str(DYNPF), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=cwd, check=False)


@pytest.mark.parametrize("name", SYSTEMS)
def test_an_example_is_the_same_on_the_bus_inline_and_replayed(name: str, tmp_path: Path) -> None:
    folder = shutil.copytree(EXAMPLES / name, tmp_path / "own")
    for shadow in ("services", "protocol", "numpy_utils"):  # names that are ours, or nearly
        (folder / shadow).mkdir()
        (folder / shadow / "__init__.py").write_text("raise RuntimeError('taken for ours')\n")
    run = ("run", folder / f"{name}.toml", "--set", "max_ticks=80")
    for runner, path in (("bus", "bus.mcap"), ("inline", "inline.mcap")):
        done = dynpf(*run, "--runner", runner, "-o", path, cwd=folder)
        assert done.returncode == 0, done.stderr
    found = [read_recording(folder / path) for path in ("bus.mcap", "inline.mcap")]
    assert content_digest(found[0]) == content_digest(found[1])
    done = dynpf(*run, "--runner", "inline", "--seed", 2, "-o", "other.mcap", cwd=folder)  # the control
    assert content_digest(read_recording(folder / "other.mcap")) != content_digest(found[0])
    replay = ("replay", "bus.mcap", "--json", "--code", ".")
    refused = dynpf(*replay, cwd=folder)
    assert refused.returncode == 2
    assert f"--allow-code {SYSTEMS[name]}" in refused.stderr
    done = dynpf(*replay, "--allow-code", SYSTEMS[name], cwd=folder)
    assert json.loads(done.stdout)["same"] is True, done.stderr


@pytest.mark.parametrize(("name", "second"), [("uwb", "ekf"), ("estimator", "pull")])
def test_estimators_beside_one_another_are_scored_in_one_table(name: str, second: str, tmp_path: Path) -> None:
    scenario = EXAMPLES / name / f"{name}.toml"
    done = dynpf("run", scenario, "--runner", "inline", "--json", "-o", "run.mcap", cwd=tmp_path)
    figures = json.loads(done.stdout)["estimators"]
    assert {*figures} == {"estimator", second}
    assert all(one["position_rmse_m"] < 0.3 for one in figures.values())
    assert figures["estimator"] != figures[second]


def test_a_study_of_ones_own_is_short_and_finds_that_more_particles_err_less(tmp_path: Path) -> None:
    study = EXAMPLES / "study" / "particles.py"
    assert len(study.read_text().splitlines()) < 40
    chosen = ("--set", "estimator.n=[5,200]", "--set", "estimator.proposal=['prior']", "--trials", 2)
    done = dynpf("study", study, *chosen, "--jobs", 2, "--json", cwd=tmp_path)
    few, many = json.loads(done.stdout)["rows"]
    assert (few["estimator.n"], many["estimator.n"]) == (5, 200)
    assert many["rmse_m_mean"] < few["rmse_m_mean"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_an_example_is_complete_in_under_150_lines(name: str) -> None:
    files = [path for path in (EXAMPLES / name).iterdir() if path.suffix in (".py", ".toml")]
    assert sum(len(path.read_text().splitlines()) for path in files) < 150


def test_messages_of_ones_own_are_kept_by_commands_that_have_no_code_for_them(tmp_path: Path) -> None:
    scenario = EXAMPLES / "uwb" / "uwb.toml"
    dynpf("run", scenario, "--set", "max_ticks=20", "--runner", "inline", "-o", "run.mcap", cwd=tmp_path)
    run = read_recording(tmp_path / "run.mcap")
    assert dynpf("recover", "run.mcap", "-o", "mended.mcap", cwd=tmp_path).returncode == 0
    assert dynpf("doctor", "mended.mcap", cwd=tmp_path).returncode == 0
    replayed = dynpf("replay", "run.mcap", "--node", "sensors", "-o", "again.mcap", cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr
    for name in ("mended.mcap", "again.mcap"):
        found = read_recording(tmp_path / name)
        assert content_digest(found) == content_digest(run)
        assert found.schemas == run.schemas
    table = dynpf("export", "run.mcap", "--format", "csv", "--topic", "ranging/ranges", cwd=tmp_path).stdout
    assert table.startswith("stamp_ns,stamp_s,sequence,anchors,ranges\n0,0.0,0,")
    assert len(table.splitlines()) == 1 + sum(1 for _ in run.messages("ranging/ranges"))
    poses = dynpf("export", "run.mcap", "--format", "tum", "--topic", "ekf/state", cwd=tmp_path).stdout
    assert len(poses.splitlines()) == 20


def test_the_node_of_the_reference_runs(tmp_path: Path) -> None:
    page = (EXAMPLES.parent / "docs" / "scenarios.md").read_text()
    blocks = page.split("## Your own nodes")[1].split("```")
    (tmp_path / "watchdog.py").write_text(next(block for block in blocks if block.startswith("python\n"))[7:])
    table = next(block for block in blocks if block.startswith("toml\n"))[5:].replace("limit = 0.5", "limit = 0.01")
    room = (EXAMPLES.parent / "scenarios" / "dynpf_scenarios" / "landmark-room.toml").read_text()
    (tmp_path / "guarded.toml").write_text(f"{room}\n{table}")
    words = ("run", "guarded.toml", "--set", "max_ticks=40", "--runner", "inline", "-o", "run.mcap")
    done = dynpf(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    alarms = [json.loads(one.payload) for one in read_recording(tmp_path / "run.mcap").messages("guard/alarm")]
    assert alarms[0] == {"since_s": 0.0}
    assert alarms[-1]["since_s"] > 0.0
