"""A sweep: a table of what varies and what is asked, whose trials are runs as ``dynpf run`` makes them."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from dynpf_experiments.drive import recorded_in
from dynpf_experiments.measures import measure
from dynpf_experiments.messages import RunMessages
from dynpf_experiments.study import run_study, settings_from
from dynpf_experiments.sweep import sweep
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_lab.cli.sweep import values_of
from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

SHORT = {"max_ticks": (15,)}


def count_of_estimates(run: RunMessages) -> float:
    return float(len(run.topic("estimator/state")))


def test_each_trial_is_the_run_of_its_settings_and_seed(tmp_path: Path) -> None:
    grid = {**SHORT, "estimator.n": (20, 30)}
    study = sweep(scenario="landmark-room", grid=grid, measures=["position_rmse_m"], trials=2)
    folder = tmp_path / "runs"
    folder.mkdir()
    with recorded_in(folder):
        samples = [one for task in study.tasks(study.settings(), 2, 7) for one in study.run_task(task)]
    found = [read_recording(folder / f"{place}.mcap") for place in range(4)]
    expected = [(20, 7), (30, 7), (20, 8), (30, 8)]
    assert [one.factors for one in samples] == [{"max_ticks": 15, "estimator.n": n} for n, _ in expected]
    assert [one.measures["position_rmse_m"] for one in samples] == [measure(one)["position_rmse_m"] for one in found]
    for recording, (n, seed) in zip(found, expected, strict=True):
        path = tmp_path / f"{n}-{seed}.mcap"
        record_inline(load_scenario("landmark-room", overrides=["max_ticks=15", f"estimator.n={n}"], seed=seed), path)
        assert content_digest(read_recording(path)) == content_digest(recording)
    assert len({content_digest(one) for one in found}) == 4


def test_the_rows_are_the_same_on_any_number_of_processes_and_for_chosen_settings() -> None:
    measures: dict[str, str | Callable[[RunMessages], float | bool]] = {
        "rmse_m": "position_rmse_m",
        "estimates": count_of_estimates,
        "many": lambda run: len(run.topics) > 2,
    }
    study = sweep(scenario="landmark-room", grid={**SHORT, "estimator.n": (20,)}, measures=measures)
    settings = settings_from(study.settings, ["estimator.n=[30, 40]"])
    rows = run_study(study, settings, 2, 1, 1)
    assert rows == run_study(study, settings, 2, 1, 2)
    assert [row["estimator.n"] for row in rows] == [30, 40]
    assert all(row["estimates_mean"] == 15.0 and row["many"] == 100.0 and row["trials"] == 2 for row in rows)


def test_the_command_line_sweeps_and_scores_each_of_several_estimators(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["landmark-filters", "--seeds", "3:4", "--set", "max_ticks=10,20", "--jobs", "1"]
    measures = ["--measure", "extended.position_rmse_m", "--measure", "position_rmse_m"]
    assert main(["sweep", *words, *measures, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [(row["max_ticks"], row["trials"]) for row in rows] == [(10, 2), (20, 2)]
    assert all(row["extended.position_rmse_m_mean"] != row["position_rmse_m_mean"] for row in rows)
    assert main(["sweep", *words, *measures]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].split("  ")[0] == "max_ticks"
    assert len(table) == 3


def test_values_are_numbers_texts_or_lists() -> None:
    assert values_of("pf.n=50,500") == ("pf.n", [50, 500])
    assert values_of("filter=ekf,ukf") == ("filter", ["ekf", "ukf"])
    assert values_of("start=[1, 2],[3, 4]") == ("start", [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["landmark-room", "--measure", "rmse", "--set", "max_ticks=5"], "no measure 'rmse'; it has position_rmse_m"),
        (["landmark-room", "--measure", "npl", "--set", "max_ticks"], "--set max_ticks: expected KEY=VALUE,..."),
        (["landmark-room", "--measure", "npl", "--set", "seed=3,4"], "seeds are chosen by --seeds FIRST:LAST"),
        (["landmark-mrclam", "--measure", "npl"], "plays an imported log: give it with --log"),
        (["landmark-room", "--measure", "npl", "--seeds", "3:1"], "expected LAST not below FIRST"),
        (["landmark-room", "--measure", "npl", "--set", "estimator.m=5"], "estimator.m"),
    ],
)
def test_bad_usage_is_told(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(["sweep", *words, "--jobs", "1"]) == 2
    assert said in capsys.readouterr().err


def test_a_sweep_that_asks_or_varies_nothing_is_refused() -> None:
    with pytest.raises(UsageError, match="needs measures"):
        sweep(scenario="landmark-room", grid={}, measures=[])
    with pytest.raises(UsageError, match=r"estimator\.n has no values"):
        sweep(scenario="landmark-room", grid={"estimator.n": ()}, measures=["npl"])


@pytest.mark.parametrize(
    ("source", "said"),
    [("X = 1", "STUDY is not in the module"), ("STUDY = 1", "STUDY is no study"), ("1 / 0", "ZeroDivisionError")],
)
def test_a_file_without_a_study_is_told(
    source: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"{tmp_path.name}.py"
    path.write_text(source)
    assert main(["study", str(path)]) == 2
    assert said in capsys.readouterr().err
    assert main(["study", str(tmp_path / "none.py")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_figures_show_each_measure(tmp_path: Path) -> None:
    study = sweep(
        scenario="landmark-room",
        grid={**SHORT, "estimator.n": (20, 30)},
        measures={"estimates": count_of_estimates, "done": lambda run: bool(run.topics)},
    )
    rows = run_study(study, study.settings(), 1, 1, 1)
    (path,) = study.figures(study.settings(), 1, rows, tmp_path)
    assert path.read_bytes().startswith(b"\x89PNG")
