"""The estimator of a capsule: each filter by its name, what it tells of the map, and what it makes of lost readings."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynpf_experiments.measures import measure, summary
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import Log, SceneUpdate
from dynpf_runtime.replay import replay_node
from dynpf_services.scenario.build import build_node, build_nodes, plan_of
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario
from dynpf_systems.colon.messages import CapsuleEstimate
from dynpf_systems.colon.tube import colon_world

from dynpf.colon import UNLISTED
from dynpf.colon.wall import Wall


def loaded(name: str, *overrides: str) -> Scenario:
    return load_scenario(name, overrides=overrides)


def run(scenario: Scenario, folder: Path) -> Recording:
    path = folder / "run.mcap"
    record_inline(scenario, path)
    return read_recording(path)


def messages(recording: Recording, topic: str) -> list[Any]:
    return [decode(topic, one.payload, recording.topics) for one in recording.messages(topic)]


def estimates(recording: Recording) -> list[CapsuleEstimate]:
    return messages(recording, "estimator/capsule")


def test_nobody_tells_of_the_change_and_it_is_found(tmp_path: Path) -> None:
    recording = run(loaded("colon-case-2"), tmp_path)
    found = estimates(recording)
    assert [one.reading for one in found] == list(range(16))
    assert [one.map for one in found] == ["a"] * 8 + ["b"] * 8
    assert found[-1].changed_at == pytest.approx(8.0, abs=0.5)
    assert all(sum(one.probability for one in estimate.maps) == pytest.approx(1.0) for estimate in found)
    assert [one.message for one in messages(recording, "log") if isinstance(one, Log)] == [
        "the map is no longer a: b since about reading 8"
    ]
    measures = measure(recording)
    assert measures["posterior_truth"] > 0.95
    assert measures["delay_steps"] == 0.0
    assert measures["missed"] is False
    assert measures["lost"] is False
    assert measures["error_position_px"] < 2.0
    assert "false_alarm" not in measures
    assert "change reported 0 readings after it could be seen" in summary(recording, measures)


def test_a_filter_that_expects_no_change_misses_it(tmp_path: Path) -> None:
    """The control of the test above."""
    measures = measure(run(loaded("colon-case-2", "estimator.filter.change=0.0"), tmp_path))
    assert measures["posterior_truth"] < 0.05
    assert measures["missed"] is True
    assert "delay_steps" not in measures


def test_walls_that_have_moved_explain_a_map_that_is_in_no_list(tmp_path: Path) -> None:
    scenario = loaded("colon-case-5")
    recording = run(scenario, tmp_path)
    last = estimates(recording)[-1]
    assert (last.map, last.reference) == (UNLISTED, "a")
    assert estimates(recording)[7].walls == ()
    world = colon_world(Context(scenario, "estimator"))
    beyond = Wall.of(world.grid("c", ""), 25.0, 35.0, 25.0).beyond
    scene = messages(recording, "estimator/scene")[-1]
    assert isinstance(scene, SceneUpdate)
    (lines,) = scene.entities[1].lines
    ends = 100.0 * np.array([(point.x, point.y) for point in lines.points[1::2]])
    assert len(ends) == len(last.walls) > 2
    for wall, (x, y) in zip(last.walls, ends, strict=True):
        before, after = beyond[round(wall.y_px), round(wall.x_px)], beyond[round(y), round(x)]
        assert np.hypot(x - wall.x_px, y - wall.y_px) == pytest.approx(abs(wall.moved_px), abs=0.01)
        assert abs(after) < max(0.3 * abs(before), 8.0), "it has moved to where the true map's wall is"


def test_a_schedule_is_a_hint_is_obeyed_or_counts_for_nothing(tmp_path: Path) -> None:
    at_the_change = {}
    for schedule in ("ignored", "hint", "obeyed"):
        chosen = loaded("colon-case-4", f"estimator.filter.schedule={schedule}", "max_ticks=9")
        (tmp_path / schedule).mkdir()
        at_the_change[schedule] = estimates(run(chosen, tmp_path / schedule))[-1]
    assert at_the_change["ignored"].map == "a"
    assert at_the_change["obeyed"].map == "b"
    assert at_the_change["obeyed"].maps == ()
    assert at_the_change["hint"].map == "a"
    assert at_the_change["hint"].maps != at_the_change["ignored"].maps


@pytest.mark.parametrize("table", ["{kind='classic'}", "{kind='end_radius', radii_px=[95, 110, 125, 140]}"])
def test_the_other_filters_follow_and_a_node_replayed_or_thawed_goes_on_as_it_did(table: str, tmp_path: Path) -> None:
    scenario = loaded("colon-growth", f"estimator.filter={table}", "estimator.start=known")
    recording = run(scenario, tmp_path)
    outcome = replay_node(recording, plan_of(scenario)._replace(state_digest_ticks=1), "estimator")
    assert (outcome.mismatch, outcome.digests) == (None, 16)
    measures, last = measure(recording), estimates(recording)[-1]
    assert measures["lost"] is False
    assert "posterior_truth" not in measures
    if "classic" in table:
        assert last.map == "end 105"
        assert "error_radius_percent" not in measures
    else:
        assert measures["error_radius_percent"] < 3.0
        assert last.changed_at == 12.0
        assert last.map == "end 140"
    frozen, thawed = (build_node(scenario, "estimator") for _ in range(2))
    thawed.thaw(frozen.freeze())
    np.testing.assert_equal(thawed.freeze(), frozen.freeze())


def test_a_start_anywhere_is_found(tmp_path: Path) -> None:
    recording = run(loaded("colon-case-1", "estimator.start=anywhere"), tmp_path)
    first, last = estimates(recording)[0], estimates(recording)[-1]
    assert first.covariance[0] > 100.0
    assert first.n_eff > 500.0
    assert measure(recording)["error_position_px"] < 2.0
    assert last.n_eff <= 100.0


def test_a_lost_reading_is_told_and_a_late_one_left_out(tmp_path: Path) -> None:
    loss = "faults=[{topic='sensors/capsule', to='estimator', loss=0.3, jitter_s=2.5}]"
    recording = run(loaded("colon-case-1", loss), tmp_path)
    numbers = [one.reading for one in estimates(recording)]
    assert numbers == sorted(set(numbers))
    assert len(numbers) < 16
    assert any("did not come in time" in one.message for one in messages(recording, "log"))


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["colon.told=[{map='c'}]", "estimator.filter.schedule=hint"], "colon.told: map 'c' is none of"),
        (["estimator.filter={kind='end_radius'}"], "colon.told: 'a' at the start"),
        (["estimator.filter.maps=['a','nothing']"], "estimator.filter.maps: map 'nothing'"),
        (["estimator.filter={kind='classic'}", "colon.told=[{map='no'}]"], "colon.told: map 'no'"),
    ],
)
def test_what_does_not_fit_is_told(overrides: list[str], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        build_nodes(loaded("colon-case-2", *overrides))
