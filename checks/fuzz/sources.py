"""The sound files that are edited: small recordings of every kind, logs of other formats, maps and scenarios."""

import lzma
import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from dynpf_formats.importers.recording import write_recording
from dynpf_formats.importers.tum import import_tum
from dynpf_services.scenario.load import load_scenario, scenario_files
from dynpf_services.scenario.record import record_inline

from checks.fuzz.bags import write_bags
from checks.fuzz.captures import write_capture
from checks.fuzz.credentials import write_keys

__all__ = ["Sources", "sources"]

MAP_YAML = """image: map.pgm
resolution: 0.1
origin: [-1.0, -1.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""

ROOM_ON_A_BITMAP = """title = "A room from an image"
tick_s = 0.1
max_ticks = 4

[map]
kind = "occupancy"
file = "map.yaml"

[simulator]
kind = "room"
width = 3.0
height = 3.0
start = [0.5, 0.5, 0.0]

[sensors]
kind = "simulated"
[sensors.odometry]
v_std = 0.005
[sensors.scan]
beams = 11
range_max = 5.0

[estimator]
kind = "localization"
n = 30
start = { kind = "known", x = 0.5, y = 0.5, theta = 0.0, sigma_position = 0.1, sigma_heading = 0.1 }
[estimator.motion]
kind = "velocity"
[[estimator.measurement]]
kind = "beam"

[controller]
kind = "waypoints"
points = [[1.0, 1.0]]
"""

_RUNS = (
    ("landmark-room", ("max_ticks=4", "estimator.n=20", "state_digest_ticks=2")),
    ("room-scan", ("max_ticks=3", "estimator.n=50", "estimator.adaptation.n_min=20", "estimator.adaptation.n_max=50")),
    ("parts-3-tracked", ("max_ticks=3",)),
    ("parts-3-easy", ("max_ticks=1",)),
    ("colon-case-1", ("max_ticks=2",)),
    ("turtlebot-room", ("max_ticks=3", "estimator.n=50")),
)


class Sources(NamedTuple):
    """The sound files, each kind by name."""

    recordings: Mapping[str, Path]
    scenarios: Mapping[str, str]
    carmen: str
    tum: str
    mrclam: Mapping[str, str]
    map: Mapping[str, bytes]
    bags: Mapping[str, Path]
    keys: Path
    capture: Path


def sources(folder: Path) -> Sources:
    """Make the files in an empty folder."""
    maps = {"map.yaml": MAP_YAML.encode(), "map.pgm": _image(".pgm"), "map.png": _image(".png")}
    for name, data in maps.items():
        (folder / name).write_bytes(data)
    (folder / "bitmap.toml").write_text(ROOM_ON_A_BITMAP)
    recordings = {}
    for name, overrides in (*_RUNS, (str(folder / "bitmap.toml"), ())):
        path = folder / f"{Path(name).stem}.mcap"
        record_inline(load_scenario(name, overrides=overrides), path)
        recordings[path.stem] = path
    tum = _tum()
    (folder / "poses.tum").write_text(tum)
    recordings["log"] = folder / "log.mcap"
    write_recording(import_tum(folder / "poses.tum"), recordings["log"])
    scenarios = {file.stem: file.read_text() for file in scenario_files()} | {"bitmap": ROOM_ON_A_BITMAP}
    bags, keys = write_bags(folder / "bags"), write_keys(folder / "keys")
    capture = write_capture(folder / "capture.mcap")
    return Sources(recordings, scenarios, _carmen(), tum, _mrclam(), maps, bags, keys, capture)


def _image(suffix: str) -> bytes:
    pixels = np.full((30, 40), 254, np.uint8)
    pixels[[0, -1], :], pixels[:, [0, -1]] = 0, 0
    return bytes(cv2.imencode(suffix, pixels)[1])


def _tum() -> str:
    rows = (f"{0.1 * k:.3f} {0.05 * k} {0.01 * k} 0 0 0 {math.sin(0.01 * k)} {math.cos(0.01 * k)}" for k in range(40))
    return "# time x y z qx qy qz qw\n" + "\n".join(rows) + "\n"


def _carmen() -> str:
    lines = ["PARAM robot_frontlaser_offset 0.1", "PARAM robot_front_laser_max 20"]
    for k in range(12):
        pose, time = f"{0.1 * k} 0 {0.02 * k}", f"{k}.5 host {k}.5"
        ranges = " ".join(str(1 + 0.1 * i) for i in range(9))
        lines.append(f"ODOM {pose} 0.1 0.02 0 {time}")
        lines.append(f"FLASER 9 {ranges} {pose} {pose} {time}")
        lines.append(f"ROBOTLASER1 0 -1.57 3.14 0.39 20 0.01 0 9 {ranges} 0 {pose} {pose} 0 0 0 0 0 {time}")
        lines.append(f"TRUEPOS {pose} {pose} {time}")
    return "\n".join(lines) + "\n"


def _mrclam() -> dict[str, str]:
    times = [f"{1000 + 0.1 * k:.3f}" for k in range(40)]
    poses = "\n".join(f"{time} {0.1 * k} {0.02 * k} 0.2" for k, time in enumerate(times))
    return {
        "Barcodes.dat": "# Subject Barcode\n1 5\n2 14\n6 72\n7 27\n",
        "Landmark_Groundtruth.dat": "6 1.0 2.0 0.001 0.001\n7 3.0 -1.0 0.001 0.001\n",
        "Robot1_Odometry.dat": "\n".join(f"{time} 0.1 0.01" for time in times),
        "Robot1_Measurement.dat": "\n".join(f"{time} {(72, 27, 14)[k % 3]} 1.5 0.2" for k, time in enumerate(times)),
        "Robot1_Groundtruth.dat": poses,
        "Robot2_Odometry.dat": "\n".join(f"{time} 0.1 0.01" for time in times),
        "Robot2_Measurement.dat": "\n".join(f"{time} 72 1.5 0.2" for time in times),
        "Robot2_Groundtruth.dat": poses,
    }


def packed(text: bytes) -> bytes:
    """Return a text as an .xz file."""
    return lzma.compress(text, preset=0)
