"""What a person looks at fits together: frames, the layout for Foxglove and Lichtblick, and the example in the docs."""

import json
import re
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
from dynpf_experiments.pictures.whole import whole
from dynpf_experiments.viewers.items import FIGURES, items
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.shipped import known_topics
from dynpf_lab.cli.serve import LAYOUT as LAYOUT_FILE
from dynpf_protocol import frames
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import FrameTransforms, LaserScan, PoseInFrame, RobotState, SceneUpdate
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

DOCS = Path(__file__).parents[3] / "docs"
LAYOUT = json.loads(LAYOUT_FILE.read_text(encoding="utf-8"))
PANELS = {"3D", "Image", "Plot", "RawMessages", "RosOut"}
SCAN = ["sensors.scan.walls=[[-3, -2, 3, -2], [3, -2, 3, 2]]"]


def _record(name: str, folder: Path, overrides: list[str]) -> Recording:
    scenario = load_scenario(name, overrides=[*overrides, "max_ticks=45"])
    path = folder / "run.mcap"
    record_inline(scenario, path)
    return read_recording(path)


@pytest.fixture(
    scope="module",
    params=[("parts-3-tracked", []), ("landmark-room", SCAN), ("colon-case-5", [])],
    ids=lambda one: one[0],
)
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    name, overrides = request.param
    return _record(name, tmp_path_factory.mktemp("run"), overrides)


def _frames(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key.endswith("frame_id"):
                yield inner
            else:
                yield from _frames(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _frames(inner)


def test_everything_is_drawn_in_the_map_or_in_a_frame_that_the_transforms_place_there(recording: Recording) -> None:
    found: defaultdict[str, set[str]] = defaultdict(set)
    for record in recording.messages():
        found[record.topic] |= set(_frames(json.loads(record.payload)))
    found = defaultdict(set, {topic: names for topic, names in found.items() if names})
    assert {"estimator/pose", "estimator/particles", "truth/scene", "estimator/transforms"} <= found.keys()
    for topic, names in found.items():
        expected = {"sensors/scan": {frames.ROBOT}, "estimator/transforms": {frames.MAP, frames.ROBOT}}
        assert names == expected.get(topic, {frames.MAP}), topic


def test_the_transform_is_the_estimated_pose_of_its_moment_and_comes_five_times_a_second(recording: Recording) -> None:
    poses = {
        record.stamp_ns: decode("estimator/pose", record.payload) for record in recording.messages("estimator/pose")
    }
    records = list(recording.messages("estimator/transforms"))
    stamps = [record.stamp_ns for record in records]
    assert len(stamps) > 5
    assert all(later - earlier >= 200_000_000 for earlier, later in pairwise(stamps))
    for record in records:
        message, pose = decode("estimator/transforms", record.payload), poses[record.stamp_ns]
        assert isinstance(message, FrameTransforms)
        assert isinstance(pose, PoseInFrame)
        (transform,) = message.transforms
        assert (transform.translation, transform.rotation) == (pose.pose.position, pose.pose.orientation)
        assert transform.timestamp == pose.timestamp


def test_the_map_of_landmarks_is_drawn_by_the_estimator_once_a_second(tmp_path: Path) -> None:
    recording = _record("landmark-room", tmp_path, [])
    records = list(recording.messages("estimator/scene"))
    stamps = [record.stamp_ns for record in records]
    assert stamps == list(range(stamps[0], stamps[0] + len(stamps) * 10**9, 10**9))
    assert len(stamps) > 3
    scene = decode("estimator/scene", records[-1].payload)
    assert isinstance(scene, SceneUpdate)
    landmarks, robot = scene.entities
    places = [(post.pose.position.x, post.pose.position.y) for post in landmarks.cylinders]
    assert places == [(mark.x, mark.y) for mark in load_scenario("landmark-room").landmarks]
    (arrow,) = robot.arrows
    last = [one for one in recording.messages("estimator/pose") if one.stamp_ns == records[-1].stamp_ns]
    pose = decode("estimator/pose", last[0].payload)
    assert isinstance(pose, PoseInFrame)
    assert arrow.pose == pose.pose


def test_the_layout_places_every_panel_once() -> None:
    placed = list(_placed(LAYOUT["layout"]))
    assert sorted(placed) == sorted(LAYOUT["configById"])
    assert {name.partition("!")[0] for name in placed} == PANELS
    assert set(LAYOUT) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}


def _placed(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in {"row", "column"}
    assert 0 < node["splitPercentage"] < 100
    yield from _placed(node["first"])
    yield from _placed(node["second"])


def _named(layout: Any) -> Iterator[tuple[str, type]]:
    """Yield every topic or message path of a layout, with the kind of thing that its panel can show."""
    drawn = {"SceneUpdate", "PoseInFrame", "PosesInFrame", "LaserScan"}
    for name, panel in layout["configById"].items():
        match name.partition("!")[0]:
            case "3D":
                for topic in panel["topics"]:
                    if not _added(topic):
                        assert known_topics()[topic].type.__name__ in drawn
                        yield topic, dict
                assert panel["followTf"] == frames.MAP
            case "Image":
                assert known_topics()[panel["imageMode"]["imageTopic"]].type.schema_name == "foxglove.CompressedImage"
                yield panel["imageMode"]["imageTopic"], dict
            case "Plot":
                for path in panel["paths"]:
                    assert path["enabled"]
                    if not path["value"].startswith(FIGURES):
                        yield path["value"], float
            case "RawMessages":
                yield panel["topicPath"], dict
            case "RosOut":
                assert known_topics()[panel["topicToRender"]].type.schema_name == "foxglove.Log"
                yield panel["topicToRender"], dict


def _added(topic: str) -> bool:
    """Return whether `dynpf export` makes a topic: the pose of a truth, the points of a scan, or the map."""
    origin, _, last = topic.rpartition("/")
    row = known_topics().get(origin)
    kinds = {"pose": RobotState, "points": LaserScan}
    return topic == "map/grid" or (row is not None and last in kinds and row.type is kinds[last])


def test_every_figure_of_the_layout_is_exported(tmp_path: Path) -> None:
    exported = set()
    for name in ("parts-3-tracked", "landmark-room"):
        (tmp_path / name).mkdir()
        exported |= {item.topic for item in items(whole(_record(name, tmp_path / name, [])), {})}
    panels = LAYOUT["configById"]
    paths = [path["value"] for name, panel in panels.items() if name.startswith("Plot") for path in panel["paths"]]
    figures = [path for path in paths if path.startswith(FIGURES)]
    assert len(figures) > 6
    for path in figures:
        topic, _, field = path.partition(".")
        assert field == "value"
        assert re.sub(r"part_[4-6]$", "part_3", topic) in exported  # other scenarios have six


def _resolve(path: str) -> type:
    """Return what a message path leads to: float for a number, dict for a message; KeyError if it leads nowhere."""
    topic, *fields = path.split(".")
    info: msgspec.inspect.Type = msgspec.inspect.type_info(known_topics()[topic].type)
    for name in fields:
        assert isinstance(info, msgspec.inspect.StructType)
        info = {field.name: field.type for field in info.fields}[name]
    return float if isinstance(info, msgspec.inspect.FloatType | msgspec.inspect.IntType) else dict


def test_every_topic_and_message_path_in_the_layout_exists() -> None:
    named = list(_named(LAYOUT))
    assert len(named) > 12
    for path, expected in named:
        assert _resolve(path) is expected, path


@pytest.mark.parametrize("path", ["truth/robots.x", "truth/robot.z", "estimator/state.pose"])
def test_a_topic_or_field_that_is_not_there_would_be_found(path: str) -> None:
    with pytest.raises(KeyError):
        _resolve(path)


def test_the_example_in_the_documentation_reads_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = _record("parts-3-tracked", tmp_path, [])
    page = (DOCS / "recording.md").read_text(encoding="utf-8")
    example, _ = re.findall(r"```python\n(.*?)```", page, re.DOTALL)  # the second is tried with the digest's tests
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "recording.md", "exec"), {})
    title, complete, *errors = capsys.readouterr().out.splitlines()
    assert title.endswith("seed 1")
    assert complete == "complete: true finished"
    assert len(errors) == len(list(recording.messages("estimator/state"))) > 0
    assert all(re.fullmatch(r" *\d+\.\d{3} s  position error 0\.\d{4} m", line) for line in errors)


def test_links_in_the_documentation_lead_somewhere() -> None:
    pages = [DOCS.parent / "README.md", *DOCS.glob("*.md")]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8"))]
    assert links
    for page, link in links:
        assert link.startswith("https://") or (page.parent / link).exists(), f"{page.name}: {link}"
