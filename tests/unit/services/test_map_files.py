"""A scenario's map files: read once, known by their content, and carried in the recording."""

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import ScenarioError
from dynpf_runtime.machines.agreement import first_difference
from dynpf_services.scenario.build import build_nodes
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import resolved_json, whole_json

SCENARIO = """
title = "A room in a file"
tick_s = 0.1
max_ticks = 12
[map]
kind = "occupancy"
file = "maps/room.yaml"
[simulator]
kind = "room"
start = [1.0, 1.0, 0.0]
[sensors]
kind = "simulated"
[sensors.odometry]
[sensors.scan]
beams = 31
[estimator]
kind = "localization"
n = 50
start = { kind = "known", x = 1.0, y = 1.0 }
measurement = "likelihood_field"
[controller]
kind = "waypoints"
points = [[2.0, 1.0]]
"""


@pytest.fixture(name="room")
def write_room(tmp_path: Path) -> Path:
    """A room of 4 m by 3 m as a scenario, a YAML file of map_server, and an image in a folder beside that."""
    (tmp_path / "maps" / "images").mkdir(parents=True)
    pixels = np.full((30, 40), 254, dtype=np.uint8)
    pixels[[0, -1]] = 0
    pixels[:, [0, -1]] = 0
    cv2.imwrite(str(tmp_path / "maps" / "images" / "room.png"), pixels)
    (tmp_path / "maps" / "room.yaml").write_text(
        "image: images/room.png\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    path = tmp_path / "room.toml"
    path.write_text(SCENARIO)
    return path


def test_files_go_by_name_and_digest_wherever_they_lie(room: Path, tmp_path: Path) -> None:
    scenario = load_scenario(str(room))
    assert set(scenario.files) == {"room.yaml", "room.png"}
    assert '"file":"room.yaml"' in resolved_json(scenario)
    assert len(resolved_json(scenario)) < 5000
    assert "estimator" in build_nodes(scenario)

    shutil.copytree(room.parent, tmp_path / "elsewhere")
    other = load_scenario(str(tmp_path / "elsewhere" / "room.toml"))
    assert resolved_json(other) == resolved_json(scenario)
    whole = tmp_path / "whole.json"
    whole.write_text(whole_json(scenario))
    assert load_scenario(str(whole)) == scenario

    image = tmp_path / "elsewhere" / "maps" / "images" / "room.png"
    cv2.imwrite(str(image), np.zeros((30, 40), dtype=np.uint8))
    changed = load_scenario(str(tmp_path / "elsewhere" / "room.toml"))
    difference = first_difference(resolved_json(scenario), resolved_json(changed))
    assert difference is not None
    assert difference[0] == "files.room.png.sha256"


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("map.file=maps/rom.yaml", "map.file: 'maps/rom.yaml' cannot be read: No such file"),
        ("map.file=room.toml", "map.file: room.toml"),
        ("map.kind=bitmap", "map.file: room.yaml: "),
        ("map={kind='bitmap'}", "object missing required field `file`"),
        ("map.kind=occupancie", "map.kind: 'occupancie'; expected one of occupancy, bitmap, segments; did you mean"),
        ("map={kind='segments', segments=[[0,0,0,0]]}", None),
    ],
)
def test_what_is_no_map_is_told(room: Path, override: str, told: str | None) -> None:
    with pytest.raises(ScenarioError) as error:
        build_nodes(load_scenario(str(room), overrides=[override]))
    assert (told or "map: segment 0 is [0.0, 0.0, 0.0, 0.0]; expected two different ends") in str(error.value)


def test_a_recording_carries_the_files_and_replays_without_them(room: Path, tmp_path: Path, capsys: Any) -> None:
    run, again = tmp_path / "run.mcap", tmp_path / "again.mcap"
    assert main(["run", str(room), "--runner", "inline", "-o", str(run)]) == 0
    image = (room.parent / "maps" / "images" / "room.png").read_bytes()
    shutil.rmtree(room.parent / "maps")
    attached = {one.name: one.data for one in read_recording(run).attachments}
    assert attached["files/room.png"] == image
    assert main(["replay", str(run)]) == 0
    assert main(["replay", str(run), "--set", "estimator.n=60", "-o", str(again)]) == 1
    assert {one.name for one in read_recording(again).attachments} == {"files/room.png", "files/room.yaml"}
    assert main(["replay", str(run), "--set", "map.file=maps/none.yaml"]) == 2
    assert "'maps/none.yaml' cannot be read" in capsys.readouterr().err
