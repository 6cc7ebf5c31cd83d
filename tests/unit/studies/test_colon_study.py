"""``dynpf study colon-...`` on few trials."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynpf_experiments.drive import drive
from dynpf_experiments.messages import of_type
from dynpf_experiments.study import run_study, settings_from
from dynpf_lab.cli.main import main
from dynpf_systems.colon.messages import CapsuleEstimate, CapsuleReading, CapsuleState
from dynpf_systems.colon.studies.experiments import CASES_STUDY, PRINTED_CASES, change_of
from dynpf_systems.colon.studies.worlds import Change, Filter, Trial, Tube, follow, run, scenario_of
from PIL import Image

from dynpf.colon.outline import Bulge, Family, tube

FEW = ["--trials", "2", "--jobs", "1", "--set", "families=['folds']", "--set", "tubes=1"]


def rows_of(capsys: pytest.CaptureFixture[str], *words: str) -> list[dict[str, Any]]:
    assert main(["study", *words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["study"] == words[0]
    return list(told["rows"])


def test_cases_stand_beside_the_printed_figures(capsys: pytest.CaptureFixture[str]) -> None:
    rows = rows_of(capsys, "colon-cases", *FEW, "--set", "filters=['seed','hypotheses']")
    assert len(rows) == 2 * 5 * 3
    for row in rows:
        assert row["trials"] == 2
        assert row["printed_error_x_percent"] == PRINTED_CASES[int(row["case"])][0]
        assert row["error_position_px_mean"] < (3.0 if row["filter"] == "hypotheses" else 40.0)
    ours = [row for row in rows if row["filter"] == "hypotheses" and row["tube"] == "all"]
    assert min(row["posterior_truth_mean"] for row in ours) > 0.9
    assert [row.get("false_alarm_percent") for row in ours] == [0.0, None, None, 0.0, None]
    assert [row.get("missed_percent") for row in ours] == [None, 0.0, 0.0, None, 0.0]


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("colon-particles", ["n=[20,30]", "n_ours=20"]),
        ("colon-growth", ["unlisted=[118.0]"]),
        ("colon-hypotheses", ["noises=['3px_5pct']", "global_trials=1"]),
    ],
)
def test_the_other_studies_say_what_they_measured(
    capsys: pytest.CaptureFixture[str], name: str, settings: list[str]
) -> None:
    rows = rows_of(capsys, name, "--trials", "1", *FEW[2:], *(word for each in settings for word in ("--set", each)))
    kinds = {(row["case"], row["filter"], row["n"], row["start"], row["noise"]) for row in rows}
    assert len(kinds) == {"colon-particles": 4 + 4 + 1, "colon-growth": 4 * 3, "colon-hypotheses": 7 + 5 + 3}[name]
    assert all(np.isfinite(row["error_theta_rad_mean"]) for row in rows if row["case"] != "all")
    said = [row for row in rows if "said" in row and row["noise"] == "all" and row["tube"] == "all"]
    assert sum(row["trials"] for row in said) == (7 * 16 if name == "colon-hypotheses" else 0)
    for row in said:
        low, high = (float(number) for number in row["said"].removesuffix(" %").replace("up to", "0 to").split(" to "))
        assert low <= row["said_percent_mean"] <= high
    if name == "colon-growth":
        assert max(row["error_radius_percent_mean"] for row in rows if row["filter"] == "end_radius") < 2.0


def test_the_same_rows_on_one_process_and_on_two() -> None:
    study = CASES_STUDY
    words = ["cases=[2]", "families=['folds']", "tubes=1", "filters=['seed','hypotheses']"]
    settings = settings_from(study.settings, words)
    one, two, other = (run_study(study, settings, 2, seed, jobs) for seed, jobs in ((1, 1), (1, 2), (2, 1)))
    assert one == two
    assert one != other


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("seed", True),
        ("seed", False),
        ("scheduled", True),
        ("told", True),
        ("hypotheses", True),
        ("hypotheses", False),
        ("end_radius", True),
    ],
)
def test_a_trial_is_the_run_of_its_scenario(name: Filter, known: bool) -> None:
    change = Change("end 105.0", ("end 120.0",), "end 105.0") if name == "end_radius" else change_of(5)
    trial = Trial(Tube(Family.FOLDS, 1), change, "robot_3px_5pct", name, 60, known, 11)
    happened = run(trial)
    track = follow(trial, happened)[0]
    ran = drive(scenario_of(trial), {"truth/capsule", "sensors/capsule", "estimator/capsule"})
    true = of_type(ran.topic("truth/capsule"), CapsuleState)
    read = of_type(ran.topic("sensors/capsule"), CapsuleReading)
    found = of_type(ran.topic("estimator/capsule"), CapsuleEstimate)
    assert [(one.x_px, one.y_px) for one in true] == [*map(tuple, happened.poses[:2].T.tolist())]
    assert [one.ranges_px for one in read] == [*map(tuple, happened.ranges.T.tolist())]
    assert [(one.x_px, one.y_px) for one in found] == [*map(tuple, track.poses[:2].T.tolist())]
    if track.maps:
        assert [{one.map: one.probability for one in estimate.maps} for estimate in found] == [
            {name: min(share, 1.0) for name, share in maps.items()} for maps in track.maps
        ]
    if track.radius is not None:
        assert found[-1].end_radius_px == track.radius
    assert len(found) == 16
    other = follow(trial._replace(seed=12), happened)[0]
    assert other.poses[0].tolist() != track.poses[0].tolist(), "other random numbers find other poses"


def drawing(path: Path, *bulges: Bulge, closed: bool = True) -> str:
    """A grey outline with specks, drawn on a larger sheet than COLON's."""
    occupied = tube(Family.IRREGULAR, 7).bore(*bulges).occupied
    inner = np.pad(~occupied, ((0, 60), (0, 90)))
    edge = inner & ~(np.roll(inner, 3, 0) & np.roll(inner, -3, 0) & np.roll(inner, 3, 1) & np.roll(inner, -3, 1))
    grey = np.where(edge, 60, 235).astype(np.uint8)
    grey[np.random.default_rng(1).integers(0, 700, 40), np.random.default_rng(2).integers(0, 1000, 40)] = 0
    if not closed:
        grey[:, 300:310] = 235
    Image.fromarray(grey[::-1]).save(path)
    return str(path)


def test_maps_of_ones_own(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    one = tube(Family.IRREGULAR, 7)
    maps = [drawing(tmp_path / "a.png"), drawing(tmp_path / "b.bmp", Bulge(False, one.bend + 25.0))]
    rows = rows_of(
        capsys,
        "colon-cases",
        "--trials",
        "2",
        "--jobs",
        "1",
        "--set",
        f"maps={maps}",
        "--set",
        "filters=['hypotheses']",
    )
    assert {row["tube"] for row in rows} == {"own", "all"}
    assert [row["case"] for row in rows if row["tube"] == "own"] == ["1", "2", "3", "4"]
    assert max(row["error_position_px_mean"] for row in rows) < 3.0
    assert min(row["posterior_truth_mean"] for row in rows) > 0.9


def test_rows_and_figures_are_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["study", "colon-cases", *FEW, "--set", "filters=['hypotheses']", "-o", str(tmp_path / "out")]
    assert main(words) == 0
    assert capsys.readouterr().out.startswith("case")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "cloud-over-time.png",
        "errors.png",
        "index.html",
        "maps-over-time.png",
        "rows.csv",
        "rows.json",
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["colon"], "unknown study 'colon'; expected one of colon-cases, colon-growth"),
        (["colon-cases", "--trials", "0"], "--trials 0: expected at least 1"),
        (["colon-cases", "--jobs", "0"], "--jobs 0: expected at least 1"),
        (["colon-cases", "--set", "tube=1"], "unknown field `tube`; settings of this study: families"),
        (["colon-cases", "--set", "tubes"], "--set tubes: expected KEY=VALUE"),
        (["colon-cases", "--set", "maps=['a.png']"], "maps of 1 files"),
        (["colon-cases", "--jobs", "1", "--set", "maps=['no.png','no.png']"], "no.png: No such file"),
        (["colon-growth", "--set", "maps=['a.png','b.png']"], "leave maps out"),
    ],
)
def test_bad_usage_is_told(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(["study", *words]) == 2
    told = capsys.readouterr().err
    assert told.startswith("dynpf study: ")
    assert said in told


def test_a_drawing_that_is_not_closed_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    maps = [drawing(tmp_path / "open.png", closed=False)] * 2
    assert main(["study", "colon-cases", "--jobs", "1", "--trials", "1", "--set", f"maps={maps}"]) == 2
    assert f"{maps[0]}: the tube around the route is not closed" in capsys.readouterr().err


def test_a_route_of_ones_own_through_maps_of_another_size(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A straight tube on a small sheet, half as wide as COLON's, with a dent outwards in b."""
    files = []
    y, x = np.mgrid[:150, :420]
    waves = 38.0 + 5.0 * np.sin(x / 17.0)
    for name, size in (("a", 0.0), ("b", 30.0)):
        reach = np.where(y > 70, waves + size * np.exp(-0.5 * ((x - 290.0) / 25.0) ** 2), waves)
        free = (np.abs(y - 70) < reach) & (x > 15) & (x < 400)
        files.append(str(tmp_path / f"{name}.png"))
        Image.fromarray(np.where(free, 255, 0).astype(np.uint8)[::-1]).save(files[-1])
    route = ["start=[60.0,70.0,0.0]", f"route={[[25.0, 0.0]] * 9}", "change=5", f"maps={files}"]
    words = [word for setting in (*route, "filters=['seed','hypotheses']") for word in ("--set", setting)]
    rows = rows_of(capsys, "colon-cases", "--trials", "2", "--jobs", "1", *words)
    ours = [row for row in rows if row["filter"] == "hypotheses" and row["tube"] == "own"]
    assert [row["case"] for row in ours] == ["1", "2", "3", "4"]
    assert max(row["error_position_px_mean"] for row in ours) < 3.0
    assert ours[1]["missed_percent"] == 0.0
