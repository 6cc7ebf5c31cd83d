"""Layouts beyond the thesis': each is what its name says, and solved."""

import numpy as np
import pytest
from dynpf_systems.parts.studies.layouts import CASES, GAP, STUDY, LayoutsSettings, case_task
from dynpf_systems.parts.studies.runs import Conditions, measured, run_parts
from dynpf_systems.parts.task import layout_of


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(5))
def test_goals_keep_their_gaps(case, seed):
    layout = layout_of(case_task(case, seed))
    first, second = np.triu_indices(len(layout.radii), 1)
    gaps = np.hypot(*(layout.goals[first] - layout.goals[second]).T) - layout.radii[first] - layout.radii[second]
    assert gaps.min() >= GAP
    assert (layout.half_size - np.abs(layout.goals) - layout.radii[:, None]).min() > 0.0


def test_a_ring_does_not_let_the_robot_pass():
    for seed in range(10):
        task = case_task("ringed", seed)
        layout = layout_of(task)
        ring, radii = layout.goals[1:], layout.radii[1:]
        gaps = np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) - radii - np.roll(radii, 1)
        assert gaps.max() < 2.0 * layout.robot_radius
        assert all(part.start == part.goal for part in task.parts[1:])


@pytest.mark.parametrize("case", ["random-6", "swap", "walled-in"])
def test_is_solved_without_a_contact_and_with_less_than_twice_the_way(case):
    found = measured(run_parts(case_task(case, 3), 3, Conditions()), Conditions())
    assert found["completed"]
    assert not found["collisions"]
    assert found["npl"] <= 2.0
    assert found["final_error_max_m"] < 0.005


def test_rows_have_the_factors_and_measures_that_scripts_read():
    study = STUDY
    settings = LayoutsSettings(cases=("swap",), noises=("none",))
    samples = [sample for part in study.tasks(settings, 2, 1) for sample in study.run_task(part)]
    (row, pooled) = study.rows(samples)
    assert (row["case"], pooled["case"], row["noise"], row["n"], row["trials"]) == ("swap", "all", "none", 0, 2)
    assert row["completed_25mm_percent"] == 100.0
    assert row["collided_percent"] == row["npl_above_2_percent"] == 0.0
    assert 1.0 < row["npl_mean"] < 2.0
