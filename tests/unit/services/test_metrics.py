"""Measures of made-up recordings whose errors are known."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
from dynpf_experiments.measures import differing, measure, summary
from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.shipped import known_topics
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.messages import (
    Estimate,
    FilterHealth,
    HealthFigures,
    Message,
    PoseInFrame,
    RobotState,
    planar_pose,
    timestamp,
)
from dynpf_services.scenario.load import parse_scenario
from dynpf_services.scenario.schema import resolved_json
from dynpf_systems.parts.messages import PartEstimate, PartsEstimate, PartsState, PartState
from mcap.records import Message as McapMessage

from checks.fuzz.anatomy import Anatomy
from tests.unit.recording.recorded_runs import HEADER

PERIOD_NS = 100_000_000
LOCALIZATION = {
    "position_rmse_m",
    "position_median_m",
    "position_p95_m",
    "heading_rmse_rad",
    "dead_reckoning_rmse_m",
    "nees_mean",
    "nees_low",
    "nees_high",
    "lost_fraction",
}
FINAL_ERRORS = {"final_error_mean_m", "final_error_max_m"}
REARRANGEMENT = {
    "finished",
    "swaps_unnoticed",
    "completed",
    "collisions",
    "npl",
    "nrl",
    "pi",
    "comp",
    "rpee_m",
    "ppee_m",
} | FINAL_ERRORS
ALWAYS = {"messages", "gaps", "complete", "outcome", "content_digest"}

ROOM = {"title": "A room", "simulator": {"kind": "room"}}
PARTS = {
    "title": "Two parts",
    "simulator": {"kind": "workspace"},
    "task": {"parts": [{"radius": 0.1, "goal": [1.0, 0.0]}, {"radius": 0.05, "goal": [0.0, 1.0]}]},
}


def record(path: Path, scenario: dict[str, Any], topics: dict[str, Sequence[Message]], **ended: Any) -> Recording:
    resolved = resolved_json(parse_scenario(scenario, ""))
    with RecordingWriter(path, RunHeader(scenario=resolved, seed=1, provenance=HEADER.provenance)) as writer:
        for topic, messages in topics.items():
            node = {"truth": "simulator", "estimator": "estimator"}[topic.partition("/")[0]]
            for tick, message in enumerate(messages):
                place = Envelope(node, "b", tick, tick, tick * PERIOD_NS, 0)
                writer.message(topic, place, encode(topic, message, known_topics()))
        writer.close(**{"complete": True, "reason": "finished", **ended})
    return read_recording(path)


def estimate(x: float, y: float, theta: float = 0.0) -> Estimate:
    return Estimate(
        x=x,
        y=y,
        theta=theta,
        covariance=(0.01, 0.0, 0.0, 0.0, 0.04, 0.0, 0.0, 0.0, 0.0025),
        n_eff=1.0,
    )


def located(*parts: tuple[float, float]) -> PartsEstimate:
    return PartsEstimate(parts=tuple(PartEstimate(x=x, y=y, variance=0.0, seen=True) for x, y in parts), held=-1)


def drive(path: Path) -> Recording:
    """A drive along x; the estimate is 0.3 m, 0.4 m and 0.1 rad off, at two of ten instants 3 m and 4 m."""
    truth = [RobotState(x=0.1 * tick, y=1.0, theta=0.0) for tick in range(10)]
    offsets = [(3.0, 4.0) if tick in (2, 7) else (0.3, 0.4) for tick in range(10)]
    dead = [
        PoseInFrame(timestamp=timestamp(0), frame_id="map", pose=planar_pose(0.1 * tick, 3.0, 0.0))
        for tick in range(10)
    ]
    return record(
        path,
        ROOM,
        {
            "truth/robot": truth,
            "estimator/state": [
                estimate(one.x + dx, one.y + dy, 0.1) for one, (dx, dy) in zip(truth, offsets, strict=True)
            ],
            "estimator/dead_reckoning": dead,
        },
    )


def test_a_recording_that_has_lost_its_estimates_has_a_summary(tmp_path: Path) -> None:
    estimates = [Estimate(x=0.0, y=0.0, theta=0.0, covariance=(0.0,) * 9, n_eff=1.0)]
    sound = record(tmp_path / "sound.mcap", ROOM, {"estimator/state": estimates})
    anatomy = Anatomy.of(sound.path.read_bytes())
    for cluster in anatomy.clusters():
        cluster.records = [one for one in cluster.records if not isinstance(one, McapMessage)]
    (tmp_path / "lost.mcap").write_bytes(anatomy.bytes())
    lost = read_recording(tmp_path / "lost.mcap")
    assert "estimator/state" in lost.schemas
    assert "messages    0" in summary(lost, measure(lost))


def test_localization(tmp_path: Path) -> None:
    measures = measure(drive(tmp_path / "run.mcap"))
    assert set(measures) == LOCALIZATION | ALWAYS
    assert measures["position_rmse_m"] == pytest.approx(math.sqrt((8 * 0.25 + 2 * 25.0) / 10))
    assert measures["position_median_m"] == pytest.approx(0.5)
    assert measures["position_p95_m"] == pytest.approx(5.0)
    assert measures["heading_rmse_rad"] == pytest.approx(0.1)
    assert measures["dead_reckoning_rmse_m"] == pytest.approx(2.0)
    assert measures["lost_fraction"] == pytest.approx(0.2)
    near = 0.09 / 0.01 + 0.16 / 0.04 + 0.01 / 0.0025
    far = 9.0 / 0.01 + 16.0 / 0.04 + 0.01 / 0.0025
    assert measures["nees_mean"] == pytest.approx((8 * near + 2 * far) / 10)
    assert measures["nees_low"] < 3.0 < measures["nees_high"]
    assert (measures["messages"], measures["gaps"], measures["complete"]) == (30, 0, True)
    json.dumps(measures, allow_nan=False)


def test_the_share_of_time_that_the_estimator_called_itself_lost(tmp_path: Path) -> None:
    verdicts: list[Literal["tracking", "lost", "uncertain"]] = ["tracking", "lost", "uncertain", "lost"]
    estimates = [
        msgspec.structs.replace(
            estimate(0.0, 0.0), health=FilterHealth(status=status, reason="", figures=HealthFigures())
        )
        for status in verdicts
    ]
    truth = [RobotState(x=0.0, y=0.0, theta=0.0)] * 4
    recording = record(tmp_path / "run.mcap", ROOM, {"truth/robot": truth, "estimator/state": estimates})
    assert measure(recording)["lost_by_verdict"] == 0.5


def move(path: Path, end: tuple[float, float] = (0.98, 0.0), contacts: int = 3, half_way: int = 2) -> Recording:
    """The first part goes from (0, 0) to ``end`` in two steps, the second stands at its goal; the robot follows.

    Half way the truth tells of the first ``half_way`` parts.
    """

    def state(x: float, y: float, count: int) -> PartsState:
        first = PartState(x=x, y=y, radius=0.1, goal_x=1.0, goal_y=0.0)
        parts = (first, PartState(x=0.0, y=1.0, radius=0.05, goal_x=0.0, goal_y=1.0))
        return PartsState(
            parts=parts[:half_way] if (x, y) == where[1] else parts,
            held=-1,
            contacts=count,
            finished=count > 0,
        )

    where = [(0.0, 0.0), (0.5, 0.0), end]
    return record(
        path,
        PARTS,
        {
            "truth/parts": [state(x, y, contacts if place == 2 else 0) for place, (x, y) in enumerate(where)],
            "truth/robot": [RobotState(x=x - 1.0, y=y, theta=0.0) for x, y in where],
            "estimator/state": [estimate(x - 1.0 + 0.03, y + 0.04) for x, y in where],
            "estimator/parts": [located((x + 0.06, y + 0.08), (0.0, 1.0)) for x, y in where],
        },
    )


def test_rearrangement(tmp_path: Path) -> None:
    measures = measure(move(tmp_path / "run.mcap"))
    assert set(measures) == REARRANGEMENT | ALWAYS | LOCALIZATION - {"dead_reckoning_rmse_m"}
    assert (measures["completed"], measures["collisions"]) == (True, 3)
    assert measures["npl"] == pytest.approx(0.98)
    # Gaps of the robot at (-1, 0), radius 0.1, to both parts, and the way between the goals.
    assert measures["nrl"] == pytest.approx(0.98 / ((1.0 - 0.2) + (math.sqrt(2.0) - 0.15) + math.sqrt(2.0)))
    assert measures["pi"] == pytest.approx((0.02 / 0.1 + 0.0) / 2)
    assert measures["final_error_mean_m"] == pytest.approx(0.01)
    assert measures["final_error_max_m"] == pytest.approx(0.02)
    assert measures["rpee_m"] == pytest.approx(0.05)
    assert measures["ppee_m"] == pytest.approx(0.1)


def test_a_truth_of_other_parts_than_the_tasks_is_not_measured(tmp_path: Path) -> None:
    assert set(measure(move(tmp_path / "run.mcap", half_way=1))) & REARRANGEMENT == set()


def test_a_part_that_is_not_quite_home_is_not_home(tmp_path: Path) -> None:
    recording = move(tmp_path / "run.mcap", end=(1.0, 0.03))
    measures = measure(recording)
    assert not measures["completed"]
    told = summary(recording, measures)
    assert "NOT all parts home, 3 collisions, farthest part 3.00 cm from its goal" in told
    assert told.startswith("Two parts (seed 1)\n")


def test_a_run_without_truth_or_end_has_only_what_can_be_told(tmp_path: Path) -> None:
    silent = record(tmp_path / "a.mcap", ROOM, {"estimator/state": [estimate(0.0, 0.0)]}, complete=False, reason="cut")
    measures = measure(silent)
    assert set(measures) == ALWAYS
    assert not measures["complete"]
    assert "INCOMPLETE: cut" in summary(silent, measures)


def test_diff_tells_the_measures_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = move(tmp_path / "a.mcap"), move(tmp_path / "b.mcap", end=(0.9, 0.0))
    assert differing(a, a) == {}
    told = differing(a, b)
    assert (
        set(told) - LOCALIZATION == {"completed", "npl", "nrl", "pi", "ppee_m"} | FINAL_ERRORS
    )  # ppee_m in its last digits
    assert told["completed"] == (True, False)
    assert told["npl"] == (pytest.approx(0.98), pytest.approx(0.9))
    assert differing(a, drive(tmp_path / "c.mcap"))["npl"] == (pytest.approx(0.98), None)
    assert main(["diff", str(a.path), str(b.path), "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["metrics"] == {name: list(pair) for name, pair in told.items()}
    assert set(printed) == {"same", "first", "counts", "metrics", "platform"}
    assert main(["diff", str(a.path), str(b.path)]) == 1
    assert ["Completed", "yes", "no"] in [line.split() for line in capsys.readouterr().out.splitlines()]
    assert main(["diff", str(a.path), str(a.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metrics"] == {}


def test_a_reference_too_sparse_to_be_interpolated_is_compared_at_its_own_poses(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    resolved = resolved_json(parse_scenario(ROOM, ""))
    # A reference a second apart; estimates between them, and two at each of its stamps: the second follows it.
    said = [("estimator/state", 1.0, 9.0), ("truth/robot", 1.0, 0.0), ("estimator/state", 1.0, 0.3)]
    said += [("estimator/state", 1.5, 9.0), ("estimator/state", 2.0, 9.0), ("truth/robot", 2.0, 0.0)]
    said += [("estimator/state", 2.0, 0.4), ("estimator/state", 2.0, 9.0), ("truth/robot", 3.0, 0.0)]
    with RecordingWriter(path, RunHeader(scenario=resolved, seed=1, provenance=HEADER.provenance)) as writer:
        counts = {"truth/robot": 0, "estimator/state": 0}
        for topic, stamp_s, x in said:
            message = estimate(x, 0.0) if topic == "estimator/state" else RobotState(x=x, y=0.0, theta=0.0)
            node = {"truth": "simulator", "estimator": "estimator"}[topic.partition("/")[0]]
            place = Envelope(node, "b", counts[topic], 0, round(stamp_s * 1e9), 0)
            writer.message(topic, place, encode(topic, message, known_topics()))
            counts[topic] += 1
        writer.close(complete=True, reason="finished")
    measures = measure(read_recording(path))
    assert measures["position_rmse_m"] == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
