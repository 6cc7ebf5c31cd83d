"""One run of the parts study: its measures, its seeds, and that filters are worth having."""

import math

import numpy as np
import pytest
from dynpf_experiments.catalogue import study_named
from dynpf_experiments.rows import Sample
from dynpf_experiments.study import run_study, settings_from
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.parts.studies.runs import LAYOUTS, RADII, Conditions, layout_task, measured, run_parts
from dynpf_systems.parts.task import NOISE


def gap(name):
    goals, radii = np.array(LAYOUTS[name]), RADII[len(LAYOUTS[name])]
    return min(math.dist(goals[i], goals[j]) - radii[i] - radii[j] for i in range(len(goals)) for j in range(i))


def run(task, seed, **given):
    conditions = Conditions(**given)
    return measured(run_parts(task, seed, conditions), conditions)


def test_layouts_are_harder_the_smaller_their_gaps():
    for easy, intermediate, hard in (("3E", "3I", "3H"), ("6E", "6I", "6H")):
        assert gap(easy) > gap(intermediate) > gap(hard) >= 0.04


def test_without_noise_parts_come_home_almost_straight():
    found = run(layout_task("3I"), 1)
    assert found["completed"]
    assert not found["collisions"]
    assert 0.9 < found["npl"] < 1.3
    assert found["final_error_max_m"] < 0.005
    assert found["rpee_m"] == found["ppee_m"] == 0.0


def test_a_filter_lowers_the_error_and_a_seed_fixes_the_run():
    given = {"variance": NOISE["high"].measurement, "max_ticks": 150}
    task = layout_task("3I")
    raw, filtered = run(task, 1, **given), run(task, 1, particles=100, **given)
    # The mean length of a two-dimensional Gaussian is sqrt(pi / 2) standard deviations.
    assert raw["rpee_m"] == pytest.approx(math.sqrt(NOISE["high"].measurement * math.pi / 2.0), rel=0.2)
    assert filtered["rpee_m"] < 0.7 * raw["rpee_m"]
    assert filtered["ppee_m"] < 0.7 * raw["ppee_m"]
    assert run(task, 1, particles=100, **given) == filtered
    assert run(task, 2, particles=100, **given) != filtered


def test_a_run_that_is_cut_short_is_not_complete():
    assert not run(layout_task("3I"), 1, max_ticks=50)["completed"]


def test_scenarios_are_the_layouts():
    for parts in (3, 6):
        for name in ("easy", "intermediate", "hard"):
            goals = [part.goal for part in load_scenario(f"parts-{parts}-{name}").task.parts]
            np.testing.assert_allclose(goals, LAYOUTS[f"{parts}{name[0].upper()}"], atol=1e-6)


def test_the_robots_error_is_near_its_bound_and_raw_measurements_are_not():
    task = layout_task("3I")
    filtered, raw = (run(task, 2, variance=NOISE["high"].measurement, particles=n, max_ticks=200) for n in (100, 0))
    assert filtered["crlb_ratio"] < 1.3 < raw["crlb_ratio"]
    assert 1.2 < filtered["robot_nees"] < 3.0
    assert 2.5 < filtered["kurtosis"] < 3.2
    assert "kurtosis" not in raw
    assert "crlb_ratio" not in run(task, 2, max_ticks=30)


def test_what_is_known_of_the_robot_doubles_with_a_part_in_its_gripper():
    course = run_parts(layout_task("3E"), 3, Conditions(NOISE["low"].measurement, 49, max_ticks=150))
    held = course.held >= 0
    assert held.any()
    assert not held.all()
    np.testing.assert_allclose(course.information[held], 2.0 * course.information[~held][0])


def test_bounds_study_has_a_row_for_each_stage_and_a_band_for_its_instants():
    study = study_named("parts-bounds")
    settings = settings_from(study.settings, ["parts=[3]", "goals=['I']", "noises=['low']", "ticks=120"])
    rows = [row for row in run_study(study, settings, 2, 5, 1) if row["goals"] == "I"]
    assert [row["stage"] for row in rows] == ["mate", "move", "all"]
    whole = rows[-1]
    assert 0.32 < whole["bound_cm_mean"] < 0.41  # with two discs in view, and with one
    assert whole["bound_noiseless_cm_mean"] < whole["bound_cm_mean"]
    assert 0.8 < whole["crlb_ratio_mean"] < 1.3
    assert whole["nees_low"] < 2.0 < whole["nees_high"]
    assert not any(key.startswith("instants") for key in whole)


def test_printed_collisions_stand_beside_those_of_six_parts():
    study = study_named("parts-6")
    samples = [
        Sample({"parts": 6, "goals": goals, "noise": "high", "n": n, "filter": name}, {"collided_percent": False})
        for goals in "EIH"
        for n, name in ((0, "none"), (100, "optimal"), (0, "extended_kalman"))
    ]
    rows = study.rows(samples)
    printed = {(row["goals"], row["filter"]): row.get("printed_collided_percent") for row in rows}
    assert [printed[goals, "none"] for goals in "EIH"] == [10, 70, 70]
    assert [printed[goals, "optimal"] for goals in "EIH"] == [0, 20, 30]
    assert printed["E", "extended_kalman"] is None
    assert next(row["comp"] for row in rows if row["goals"] == "H") == pytest.approx(16.4, abs=0.05)


def test_cells_of_a_task_study():
    """A Kalman filter once, and each number of particles; normalized by the run without noise."""
    study = study_named("parts-3")
    chosen = ["goals=['I']", "noises=['none','low']", "n=[49]", "filters=['optimal','extended_kalman']"]
    settings = settings_from(study.settings, chosen)
    rows = [row for row in run_study(study, settings, 1, 1, 1) if row["goals"] == "I"]
    assert [(row["noise"], row["n"], row["filter"]) for row in rows] == [
        ("none", 0, "none"),
        ("low", 0, "extended_kalman"),
        ("low", 49, "optimal"),
    ]
    assert rows[0]["npl_normalized_mean"] == 1.0
    assert rows[2]["npl_normalized_mean"] == pytest.approx(rows[2]["npl_mean"] / rows[0]["npl_mean"])
    assert all(row["completed_25mm_percent"] == 100.0 for row in rows)


def test_times_of_a_step_stand_beside_the_printed_ones():
    study = study_named("parts-time")
    settings = settings_from(study.settings, ["parts=3", "goals=E", "n=[49]"])
    rows = run_study(study, settings, 1, 1, 1)
    assert {(row["stage"], row["printed_filter_ms"]) for row in rows} == {("mate", 40), ("move", 90), ("all", None)}
    for row in rows:
        assert {"controller_ms_best", "controller_ms_median", "controller_ms_p99", "estimator_ms_p99"} <= row.keys()
        assert ("filter_ms_median" in row) == (row["stage"] != "all")
