"""What a page shows of a run is what its recording says."""

import json
from typing import Any

import msgspec
import numpy as np
from dynpf_experiments.measures import lines_of
from dynpf_experiments.messages import recorded as messages_of
from dynpf_experiments.pictures import packing
from dynpf_experiments.pictures.estimates import error_plots
from dynpf_experiments.pictures.page import apart, measures_in_words
from dynpf_experiments.pictures.scenes import scenes_of
from dynpf_experiments.pictures.source import Budget, RunSource
from dynpf_protocol.messages import Estimate, Gap, RobotState
from dynpf_systems.colon.scene import M_PER_PX

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.metrics.consistency import nees
from tests.unit.page.runs import picture, recorded, short_run

TICKS = 60


def values(packed: dict[str, Any]) -> list[float]:
    steps, found = 0, []
    for difference in packed["d"]:
        steps += difference
        found.append(steps * packed["q"])
    return found


def tracks(data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {track["name"]: track for track in data["tracks"]}


def test_truth_and_estimate_are_there_at_every_tick() -> None:
    run = short_run("landmark-room", TICKS)
    data = picture(run).data
    assert values(data["moments"]["tick"]) == list(range(TICKS))
    for name, topic in (("truth", "truth/robot"), ("estimator", "estimator/state")):
        known = messages_of(run).topic(topic)
        track = tracks(data)[name]
        for key, field in (("x", "x"), ("y", "y"), ("h", "theta")):
            expected = [getattr(timed.message, field) for timed in known]
            assert np.allclose(values(track[key]), expected, rtol=0.0, atol=0.51 * track[key]["q"])
        assert np.allclose(values(track["t"]), [timed.stamp_ns * 1e-9 for timed in known], rtol=0.0, atol=1e-3)


def test_errors_are_those_of_the_measures() -> None:
    run = short_run("landmark-room", TICKS)
    source = messages_of(run)
    states = [timed.message for timed in source.topic("truth/robot") if isinstance(timed.message, RobotState)]
    estimates = [timed.message for timed in source.topic("estimator/state") if isinstance(timed.message, Estimate)]
    errors = np.array([(a.x - b.x, a.y - b.y) for a, b in zip(estimates, states, strict=True)]).T
    covariances = np.array([each.covariance for each in estimates]).reshape(-1, 3, 3)[:, :2, :2]
    plots = {plot["key"]: plot for plot in picture(run).data["plots"]}
    (error,) = [line for line in plots["position_error"]["lines"] if line["label"] == "error"]
    assert np.allclose(values(error["v"]), np.hypot(*errors), rtol=0.0, atol=1e-5)
    assert np.allclose(values(plots["nees"]["lines"][0]["v"]), nees(errors, covariances), rtol=1e-3, atol=1e-3)


def test_a_run_without_truth_has_no_errors() -> None:
    assert error_plots([], "m") == []


def test_less_is_shown_of_a_long_run_and_the_page_says_so() -> None:
    run = short_run("landmark-room", TICKS)
    shown = picture(run, Budget(moments=10, values=20, clouds=3, readings=4))
    assert len(shown.data["moments"]["t"]["d"]) == 10
    assert max(len(line["v"]["d"]) for plot in shown.data["plots"] for line in plot["lines"]) <= 20
    assert len(shown.data["clouds"][0]["p"]["n"]) == 3
    assert f"10 of {TICKS} poses of truth" in shown.notes
    assert any("3 of" in note and "particles" in note for note in shown.notes)


def test_gaps_and_the_end_are_events() -> None:
    run = recorded("faults")
    shown = picture(run)
    kinds = [event.kind for event in shown.events]
    assert kinds[-1] == "end"
    assert kinds.count("gap") == min(199, sum(timed.message is not None for timed in _gaps(run)))
    assert shown.faults


def _gaps(run: Any) -> list[Any]:
    source = messages_of(run)
    return [timed for topic in source.topics if topic.startswith("event/") for timed in source.topic(topic)] + [
        timed for topic in source.carrying(Gap) for timed in source.topic(topic)
    ]


def test_systems_bring_their_worlds() -> None:
    room = picture(short_run("landmark-room", TICKS)).data
    assert [shape["s"] for shape in room["shapes"] if shape["w"] == "landmark"] == list("12345678")
    parts = picture(recorded("camera")).data
    assert {"part 1", "estimate of part 1"} <= {*tracks(parts)}
    assert all(len(circles) == 4 for circles in parts["cameras"][0]["circles"][1:])
    capsule = picture(recorded("colon")).data
    assert capsule["unit"] == "px"
    assert capsule["shapes"] or capsule["layers"]


def test_scenes_are_drawn_from_above_in_the_unit_of_the_page() -> None:
    source = RunSource(recorded("colon"), Budget())
    shapes, layers = scenes_of(source, frozenset({"capsule", "estimated capsule"}), 1.0 / M_PER_PX)
    drawn = [*shapes, *(shape for layer in layers for shapes in layer.shapes for shape in shapes)]
    loops = [shape for shape in drawn if shape.form == "loop"]
    assert loops
    track = tracks(picture(recorded("colon")).data)["truth"]
    left, right = (min(values(track["x"])), max(values(track["x"])))
    assert min(loop.points[0].min() for loop in loops) < left < right < max(loop.points[0].max() for loop in loops)


def test_large_maps_become_coarser_and_keep_their_walls() -> None:
    cells = np.zeros((1300, 700), dtype=np.uint8)
    cells[:, 350] = 1
    packed = packing.grid(OccupancyGrid(cells, 0.05))
    assert (packed["h"], packed["w"], round(packed["resolution"], 9)) == (434, 234, 0.15)
    assert sum(run >> 2 for run in packed["runs"] if run & 3 == 1) == 434


def test_two_runs_are_set_apart_where_diff_says() -> None:
    a, b = short_run("landmark-room", TICKS), short_run("landmark-room", 40)
    assert apart(a, a).same
    assert apart(a, a).tick is None
    found = apart(a, b)
    assert not found.same
    assert found.tick is not None
    assert ("messages") in [name for name, *_ in found.measures]


def test_pages_hold_only_finite_numbers_and_plain_values() -> None:
    for run in (short_run("landmark-room", TICKS), recorded("camera"), recorded("colon"), recorded("faults")):
        data = picture(run).data
        assert msgspec.json.decode(json.dumps(data, allow_nan=False)) == data


def test_a_measure_of_several_lines_is_one() -> None:
    frames = {
        "truth_offset": [1.0, 2.0, 0.5],
        "position_rmse_m": 0.02,
        "position_median_m": 0.02,
        "heading_rmse_rad": 0.1,
    }
    measures = {"position_rmse_m": 15.0, "position_median_m": 15.0, "heading_rmse_rad": 0.05, "alignment": frames}
    told = lines_of(measures)
    assert any(line.startswith("   ") for line in told), "the control: a line that goes on"
    rows = measures_in_words(measures)
    assert [name for name, _ in rows] == ["position", "heading", "frames"]
    assert "28.65 deg. The reference" in rows[-1][1]
    assert "--truth-offset" in rows[-1][1]
