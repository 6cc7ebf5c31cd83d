"""What viewers get of a run: Foxglove's shapes in protobuf, scans in the map's frame, numbers; and what Rerun reads."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dynpf_experiments.measures import measure
from dynpf_experiments.pictures.whole import whole
from dynpf_experiments.viewers.foxglove import encoded, schema_of
from dynpf_experiments.viewers.items import Item, Number, items
from dynpf_experiments.viewers.shapes import Grid, PointCloud
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_lab.notebook import run
from dynpf_protocol.messages import FrameTransforms, PoseInFrame
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from mcap.reader import make_reader

ROOT = Path(__file__).parents[3]
VIEWERS = next(iter((ROOT / ".venv-viewers").glob("lib/python*/site-packages")), None)
SIDE = Path(__file__).with_name("viewer_side.py")


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a map of cells and scans."""
    path = tmp_path_factory.mktemp("viewers") / "run.mcap"
    run("indoor-tracking", settings={"max_ticks": 60}, path=path)
    return path


@pytest.fixture(scope="module")
def shown(scanned: Path) -> list[Item]:
    recording = read_recording(scanned)
    return list(items(whole(recording), measure(recording)))


def points(cloud: object) -> np.ndarray:
    assert isinstance(cloud, PointCloud)
    return np.frombuffer(cloud.data, dtype="<f4").reshape(-1, 3)[:, :2]


def test_scans_lie_on_the_map_s_walls(shown: list[Item]) -> None:
    (walls,) = [points(item.shown) for item in shown if item.topic == "map/points"]
    scans = [points(item.shown) for item in shown if item.topic == "sensors/scan/points"]
    assert len(scans) >= 10
    ends = np.concatenate(scans)
    gaps = np.sqrt(((ends[:, None] - walls[None]) ** 2).sum(axis=2).min(axis=1))
    assert np.median(gaps) < 0.1
    away = ends[:, None] + np.array([0.5, 0.5])  # the control: scans at another place do not
    assert np.median(np.sqrt(((away - walls[None]) ** 2).sum(axis=2).min(axis=1))) > 0.1


def test_the_map_s_cells_are_those_of_the_run(shown: list[Item], scanned: Path) -> None:
    (grid,) = whole(read_recording(scanned)).drawing.cells
    (told,) = [item.shown for item in shown if isinstance(item.shown, Grid)]
    cells = np.frombuffer(told.data, dtype=np.uint8).reshape(-1, told.column_count, 4)
    assert told.cell_size.x == grid.resolution
    assert (told.pose.position.x, told.pose.position.y) == grid.origin[:2]
    assert np.array_equal(cells[..., 0] == 0, grid.occupied)


def test_errors_and_verdicts_are_numbers_over_time(shown: list[Item]) -> None:
    numbers = [(item.topic, item.shown.value) for item in shown if isinstance(item.shown, Number)]
    errors = [value for topic, value in numbers if topic == "figures/position_error/error"]
    assert 50 <= len(errors) <= 60
    assert 0.0 < max(errors) < 0.5
    assert next(value for topic, value in numbers if topic == "figures/health/estimator") == 0.0
    stamps = [item.stamp_ns for item in shown]
    assert stamps == sorted(stamps)


def test_each_frame_has_one_parent_where_several_filters_follow_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    run("landmark-filters", settings={"max_ticks": 5}, path=path)
    recording = read_recording(path)
    owners: dict[str, set[str]] = {}
    for item in items(whole(recording), {}):
        if isinstance(item.shown, FrameTransforms):
            for each in item.shown.transforms:
                owners.setdefault(each.child_frame_id, set()).add(item.topic)
    assert owners == {
        "robot": {"estimator/transforms"},
        "extended/robot": {"extended/transforms"},
        "unscented/robot": {"unscented/transforms"},
    }


def test_protobuf_says_what_the_recording_does(shown: list[Item]) -> None:
    item = next(item for item in shown if item.topic == "estimator/pose")
    assert isinstance(item.shown, PoseInFrame)
    encoding, name, _, schema = schema_of(item)
    assert encoding == "protobuf"
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString(encoded(item))
    told = json_format.MessageToDict(message, preserving_proto_field_name=True)
    assert told["pose"]["position"]["x"] == item.shown.pose.position.x
    assert told["pose"]["orientation"]["z"] == item.shown.pose.orientation.z
    assert told["frame_id"] == "map"


def test_the_same_run_gives_the_same_file(scanned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / "a.foxglove.mcap", tmp_path / "b.foxglove.mcap"]
    for file in files:
        assert main(["export", str(scanned), "--format", "foxglove", "-o", str(file)]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    with files[0].open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} >= {"map/grid", "sensors/scan", "estimator/scene"}
    assert main(["export", str(scanned), "--format", "foxglove", "-o", str(files[0])]) == 2
    assert "the file exists" in capsys.readouterr().err


@pytest.mark.skipif(VIEWERS is None, reason="no Rerun here: make viewers")
def test_rerun_decodes_images_poses_points_transforms_and_plots(scanned: Path, tmp_path: Path) -> None:
    env = os.environ | {"PYTHONPATH": str(VIEWERS)}
    camera = ROOT / "recordings" / "camera.mcap"
    made = [tmp_path / name for name in ("run.foxglove.mcap", "run.rrd", "camera.foxglove.mcap", "camera.rrd")]
    for path, recording in zip(made, (scanned, scanned, camera, camera), strict=True):
        form = "rerun" if path.suffix == ".rrd" else "foxglove"
        words: list[str | Path] = [sys.executable, "-m", "dynpf_lab.cli.main", "export", recording]
        words += ["--format", form, "-o", path]
        subprocess.run(words, check=True, env=env, capture_output=True)
    done = subprocess.run([sys.executable, SIDE, *made], check=True, env=env, capture_output=True, text=True)
    mcap, rrd, frames, frames_rrd = json.loads(done.stdout).values()
    # Foxglove's protobuf, as Rerun itself reads it.
    assert mcap["/estimator/particles"]["InstancePoses3D:translations"] > 5
    assert mcap["/estimator/transforms"]["Transform3D:translation"] > 5
    assert mcap["/sensors/scan/points"]["Points3D:positions"] > 5
    assert mcap["/map/points"]["Points3D:positions"] == 1
    assert mcap["/map/image"]["EncodedImage:blob"] == frames["/camera/image"]["EncodedImage:blob"] / 6 == 1
    # Rerun's own form, with plots.
    assert (
        rrd["/estimator/particles"]["Arrows3D:origins"] == mcap["/estimator/particles"]["InstancePoses3D:translations"]
    )
    assert rrd["/estimator/transforms/robot"]["Transform3D:translation"] > 5
    assert rrd["/sensors/scan/points"]["Points3D:positions"] > 5
    assert rrd["/map/image"]["EncodedImage:blob"] == frames_rrd["/camera/image"]["EncodedImage:blob"] / 6 == 1
    assert 50 <= rrd["/figures/position_error/error"]["Scalars:scalars"] <= 60
    assert rrd["/figures/measures/position_rmse_m"]["values"] == [measure(read_recording(scanned))["position_rmse_m"]]
