"""dynpf localize on a made-up ROS 2 bag whose reference is in a frame of its own, and what cannot be localized."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the package rosbags is not installed")

from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import RobotState
from rosbags.rosbag2 import StoragePlugin

from dynpf.measurement.ray import ray_segments
from dynpf.se2 import compose
from tests.unit.importers import bags
from tests.unit.importers.bags import Said, write_ros2, yaw

T = 10**9
S = 1_700_000_000 * T
CELL = 0.1
ANGLES = np.linspace(-2.0, 2.0, 61)
WALLS = np.array(
    [(0, 0, 9, 0), (9, 0, 9, 6), (9, 6, 0, 6), (0, 6, 0, 0), (3, 0, 3, 1.5), (6.5, 6, 6.5, 4.2), (0, 4, 1.2, 4)],
    dtype=float,
)
TO_ODOM = (2.0, 2.5, 0.3)
OFFSET = (-40.0, 12.0, 0.4)
"""Pose of the map in the frame of the reference."""


def cells() -> list[list[int]]:
    """Return the room's cells as ROS has them, a margin of unknown ones about it."""
    found = np.full((70, 100), -1)
    found[5:66, 5:96] = 0
    for x1, y1, x2, y2 in WALLS:
        for share in np.linspace(0.0, 1.0, 400):
            found[5 + round((y1 + share * (y2 - y1)) / CELL), 5 + round((x1 + share * (x2 - x1)) / CELL)] = 100
    return [[int(cell) for cell in row] for row in found]


def laser(stamp_ns: int, pose: np.ndarray) -> Any:
    ranges = ray_segments(pose[:2], ANGLES + pose[2], WALLS)
    geometry = {"angle_min": -2.0, "angle_max": 2.0, "angle_increment": 4.0 / 60.0, "range_max": 12.0}
    return bags.scan(stamp_ns, ranges.tolist(), frame="laser", **geometry)


def drive(path: Path, *, with_map: bool = True) -> Path:
    """Write a bag of six seconds; the odometry's frame lies elsewhere, and tf corrects it from the second second on."""
    origin = -5.5 * CELL
    said: list[Said] = [("/tf_static", S, bags.transform(S, "base_link", "laser", (0.0, 0.0, 0.2)))]
    said += [("/map", S, bags.grid(cells(), CELL, origin, origin, 0.0))] if with_map else []
    to_odom = np.array(TO_ODOM)
    for k in range(61):
        stamp_ns = S + k * T // 10
        in_odom = np.array([0.06 * k, 0.3 * math.sin(0.1 * k), 0.01 * k])
        pose = compose(to_odom, in_odom)
        truth = compose(np.array(OFFSET), pose)
        x, y, turn = to_odom if k >= 10 else np.zeros(3)
        said += [
            ("/tf", stamp_ns, bags.transform(stamp_ns, "map", "odom", (x, y, 0.0), yaw(turn))),
            ("/odom", stamp_ns, bags.odometry(stamp_ns, *in_odom.tolist())),
            ("/ground_truth", stamp_ns, bags.pose(stamp_ns, truth[0], truth[1], yaw(truth[2]))),
            ("/scan", stamp_ns, laser(stamp_ns, pose)),
        ]
    return write_ros2(path, said, StoragePlugin.MCAP)


def localize(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, dict[str, Any]]:
    code = main(["localize", *map(str, words), "--no-page", "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_from_a_bag_to_a_verdict_with_the_reference_in_another_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, folder = drive(tmp_path / "bag"), tmp_path / "out"
    code, found = localize(capsys, bag, "-o", folder)
    assert (code, found["localized"]) == (0, True), found["verdict"]
    assert found["frames"]["agree"] is False
    assert found["measures"]["position_rmse_m"] > 30.0
    assert found["measures"]["alignment"]["truth_offset"] == pytest.approx(OFFSET, abs=0.1)
    assert found["measures_aligned"]["position_rmse_m"] < 0.1
    assert found["fit"]["estimate"] > 0.8
    # What the robot itself held for its pose, from when it had corrected anything, is where it was.
    theirs = [decode(one.topic, one.payload) for one in read_recording(Path(found["log"])).messages("log/localized")]
    assert len(theirs) == 51
    assert isinstance(theirs[0], RobotState)
    expected = compose(np.array(TO_ODOM), np.array([0.6, 0.3 * math.sin(1.0), 0.1]))
    assert (theirs[0].x, theirs[0].y, theirs[0].theta) == pytest.approx(tuple(expected))
    assert found["start"]["pose"] == pytest.approx(TO_ODOM, abs=1e-6)
    assert "own localization" in found["start"]["why"]

    params = tmp_path / "nav2.yaml"
    params.write_text("amcl:\n  ros__parameters:\n    laser_max_range: 30.0\n    set_initial_pose: true\n")
    code, again = localize(capsys, found["log"], "-o", folder, "--start", "last", "--amcl", params)
    assert again["start"]["pose"] == pytest.approx([found["last_pose"][axis] for axis in ("x", "y", "theta")])
    assert "scan_range_max" not in Path(again["scenario"]).read_text()  # the scanner itself sees only 12 m
    assert again["recording"] != found["recording"]
    assert (code, again["localized"]) == (1, False), "it was not there at the start of the log"


def test_a_last_pose_of_another_map_and_a_log_without_a_map_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    bag = drive(tmp_path / "bag")
    folder.mkdir()
    pose = {"x": 1.0, "y": 1.0, "theta": 0.0, "map_sha256": "other", "recording": "r.mcap", "stamp_ns": 1}
    (folder / "last_pose.json").write_text(json.dumps(pose))
    assert main(["localize", str(bag), "-o", str(folder), "--start", "last"]) == 2
    assert "is a pose in another map, of r.mcap" in capsys.readouterr().err
    assert main(["localize", str(drive(tmp_path / "bare", with_map=False)), "-o", str(folder)]) == 2
    assert "scans and no map to localize in: give it with --map" in capsys.readouterr().err
    assert main(["localize", str(tmp_path / "none"), "-o", str(folder)]) == 2
    assert "none: no such file or folder" in capsys.readouterr().err


def test_a_scenario_without_readings_in_the_log_and_a_start_off_the_map_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, run = tmp_path / "log.mcap", tmp_path / "run.mcap"
    assert main(["import", "rosbag", str(drive(tmp_path / "bag")), "-o", str(log)]) == 0
    assert main(["run", "landmark-mrclam", "--log", str(log), "-o", str(run)]) == 2
    told = capsys.readouterr().err
    assert "estimator.measurement: takes log/landmarks, of which the log has none; it has log/" in told
    # The start is the first reference pose, which is in another frame.
    words = ["run", "laser-log", "--runner", "inline", "--no-page"]
    assert main([*words, "--log", str(log), "-o", str(run), "--set", "max_ticks=3"]) == 0
    assert "warning: estimator: the start (-39.13, 15.08) m lies outside the map" in capsys.readouterr().err
    # A reference of another time is told at import and by metrics.
    late, other = tmp_path / "late.txt", tmp_path / "other.mcap"
    late.write_text("".join(f"{1_700_004_006 + k} 0 {k} 0 0 0 0 1\n" for k in range(5)))
    assert main(["import", "tum", str(late), "--log", str(log), "-o", str(other)]) == 0
    assert "warning: the reference begins 4000.0 s after the log ends" in capsys.readouterr().out
    assert main([*words, "--log", str(other), "-o", str(tmp_path / "late.mcap")]) == 0
    capsys.readouterr()
    assert main(["metrics", str(tmp_path / "late.mcap")]) == 0
    assert "not scored: no estimate has a reference: the reference begins 40" in capsys.readouterr().out
