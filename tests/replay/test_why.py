"""``dynpf why`` on a run with a planted failure, and on the inputs that it cannot answer."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from dynpf_experiments.why.causes import events_of, ways_of
from dynpf_experiments.why.condition import parse
from dynpf_experiments.why.futures import Future, Trunk
from dynpf_experiments.why.quantities import quantities_of
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

from checks.why.cases import RUNS

TICK = 30
WHEN = "position_error > 0.5 and tick > 33"
KIDNAPPED = f"simulator.kidnappings=[{{tick={TICK}, to=[-2.0, 1.0, 0.0]}}, {{tick=10, to=[-1.7, -1.2, 0.0]}}]"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    overrides = ["max_ticks=60", "estimator.n=30", KIDNAPPED]
    record_inline(load_scenario(str(RUNS / "kidnapped.toml"), overrides=overrides), path)
    return path


def test_a_kidnapping_is_named_with_its_tick_and_drawn(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = tmp_path / "why.svg"
    assert main(["why", str(run), "--when", WHEN, "--jobs", "1", "--json", "-o", str(figure)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["failed"]["tick"] == 34
    assert found["inevitable"] == [TICK, TICK]
    assert found["chance"] is None
    assert [cause["key"] for cause in found["causes"]] == ["simulator.kidnappings.0"]
    assert found["causes"][0]["without"]["failed"] == 0
    texts = [text.text for text in ElementTree.parse(figure).iter("{http://www.w3.org/2000/svg}text")]
    assert f"fails in tick {found['failed']['tick']}" in texts


def test_a_future_without_a_change_is_the_run_and_others_do_not_depend_on_the_order(run: Path) -> None:
    recording = read_recording(run)
    scenario = load_scenario(str(RUNS / "kidnapped.toml"), overrides=["max_ticks=60", "estimator.n=30", KIDNAPPED])
    plan = plan_of(scenario)

    def trunk() -> Trunk:
        return Trunk(recording, scenario, parse(WHEN), quantities_of(parse(WHEN), WHEN, plan), within=10)

    event = next(event for event in events_of(scenario) if event.tick == TICK)
    futures = [Future(tick) for tick in (1, 25, 34)] + [Future(tick, seed=7, cause=event) for tick in (20, TICK, 31)]
    forwards, backwards = trunk(), trunk()
    fates = [forwards.fails(future) for future in futures]
    assert fates == [True, True, True, False, False, True]
    assert [backwards.fails(future) for future in reversed(futures)] == fates[::-1]


def test_inputs_and_decisions_are_those_of_the_estimator_and_the_source() -> None:
    ways = {way.topic: way.kind for way in ways_of(plan_of(load_scenario("landmark-room")))}
    assert ways == {"sensors/odometry": "input", "sensors/landmarks": "input", "controller/command": "decision"}


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--when", "position_error > 50"], "the condition holds in none of 60 ticks: position_error was 0"),
        (["--when", "position_error > 0"], "the condition holds in the first tick"),
        (["--when", WHEN, "-o", "why.png"], "end its name with .svg"),
        (["--when", "position_eror > 1"], "did you mean 'position_error'"),
    ],
)
def test_what_cannot_be_answered_is_said(
    run: Path, words: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["why", str(run), *words]) == 2
    assert problem in capsys.readouterr().err
