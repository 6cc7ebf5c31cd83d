"""Draws docs/run.png, the picture in the README: `python -m docs.figures`.

Runs parts-3-easy and landmark-room with seed 1, in one process, and draws what their recordings hold.
"""

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import matplotlib as mpl
import numpy as np
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.codec import decode
from dynpf_services.scenario.load import load_scenario, override_resolved
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray
from PIL import Image

__all__ = ["draw"]

PICTURE = Path(__file__).with_name("run.png")
DPI = 110

# Okabe and Ito's colours, told apart by everybody; line styles tell them apart in print without colour, too.
TRUE = "#222222"
ESTIMATED = "#d55e00"
RECKONED = "#0072b2"
PARTS = ("#009e73", "#cc79a7", "#56b4e9")
FOUND = "#f0e442"


class Series(NamedTuple):
    """All messages of a topic with their stamps in seconds."""

    stamps: NDArray[np.float64]
    messages: list[Any]


def draw(parts: Recording, room: Recording, path: Path) -> None:
    """Draw a run of parts-3-easy and one of landmark-room, side by side, into a PNG file."""
    with mpl.rc_context({"font.size": 8.5, "axes.titlesize": 10, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(14.0, 4.6), dpi=DPI, layout="constrained")
        camera, paths, rounds = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.42])
        _draw_camera(camera, parts)
        _draw_rearrangement(paths, parts)
        _draw_room(rounds, room)
        figure.savefig(path)
    with Image.open(path) as image:
        image.convert("RGB").save(path, optimize=True)


def _draw_camera(axes: Axes, recording: Recording) -> None:
    scenario = _scenario(recording)
    images, found = _series(recording, "camera/image"), _series(recording, "vision/detections")
    held = [message.held for message in _series(recording, "truth/parts").messages]
    carrying = [place for place, part in enumerate(held) if part >= 0]
    shown = carrying[len(carrying) // 2]
    frame = cv2.imdecode(np.frombuffer(images.messages[shown].data, np.uint8), cv2.IMREAD_COLOR)
    assert frame is not None
    assert scenario.vision is not None
    assert scenario.task is not None
    axes.imshow(frame[::2, ::2, ::-1], extent=(-0.5, frame.shape[1] - 0.5, frame.shape[0] - 0.5, -0.5))
    projection = scenario.vision.calibrated().projection
    around = np.linspace(0.0, 2.0 * np.pi, 90)
    for number, disc in enumerate(found.messages[shown].discs):
        rim = np.array([disc.x, disc.y]) + disc.radius * np.column_stack([np.cos(around), np.sin(around)])
        label = "discs found by vision" if number == 0 else None
        axes.plot(*projection.to_pixels(rim).T, color="black", lw=3.2)
        axes.plot(*projection.to_pixels(rim).T, color=FOUND, lw=1.8, label=label)
        centre = projection.to_pixels(np.array([disc.x, disc.y]))
        axes.plot(*centre, "+", color=FOUND, ms=9, mew=1.8)
    half = np.array([scenario.task.width, scenario.task.height]) / 2.0
    corners = projection.to_pixels(half * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]))
    axes.set_xlim(corners[:, 0].min() - 20, corners[:, 0].max() + 20)
    axes.set_ylim(corners[:, 1].max() + 20, corners[:, 1].min() - 20)
    axes.set_title(f"parts-3-easy: the camera's view at t = {images.stamps[shown]:.1f} s")
    axes.set_xlabel("u (px)")
    axes.set_ylabel("v (px)")
    _legend(axes, 1)


def _draw_rearrangement(axes: Axes, recording: Recording) -> None:
    task = _scenario(recording).task
    assert task is not None
    axes.add_patch(Rectangle((-task.width / 2, -task.height / 2), task.width, task.height, fill=False, lw=1.5))
    truth, robot = _series(recording, "truth/parts").messages, _series(recording, "truth/robot").messages
    estimates = _series(recording, "estimator/state").messages
    located = _series(recording, "estimator/parts").messages
    true = np.array([(one.x, one.y) for one in robot])
    axes.plot(*true.T, color=TRUE, lw=2.4, alpha=0.35, label="robot, true path")
    axes.plot(*np.array([(one.x, one.y) for one in estimates]).T, color=ESTIMATED, lw=0.7, label="estimated path")
    axes.add_patch(Circle((true[0][0], true[0][1]), task.robot_radius, fill=False, color=TRUE, lw=1.2, ls="--"))
    axes.annotate("robot", true[0], ha="center", va="center", fontsize=7)
    for number, (part, colour) in enumerate(zip(task.parts, PARTS, strict=False)):
        path = np.array([(state.parts[number].x, state.parts[number].y) for state in truth])
        estimated = np.array([(one.parts[number].x, one.parts[number].y) for one in located])
        axes.add_patch(Circle(part.goal, part.radius, facecolor=colour, alpha=0.35))
        axes.add_patch(Circle((path[-1][0], path[-1][1]), part.radius, fill=False, color=colour, lw=1.6))
        axes.add_patch(Circle((path[0][0], path[0][1]), part.radius, fill=False, color=colour, lw=1.2, ls="--"))
        axes.plot(*path.T, color=colour, lw=3.0, label=f"part {number + 1}, true path")
        axes.plot(*estimated.T, color=ESTIMATED, lw=0.7)
        beside = (path[0][0] + part.radius + 0.05, path[0][1])
        axes.annotate(f"{number + 1}", beside, ha="center", va="center", weight="bold")
    axes.scatter([], [], s=60, facecolors="none", edgecolors="grey", linestyles="--", label="start")
    axes.scatter([], [], s=60, facecolors="none", edgecolors="grey", label="end")
    axes.scatter([], [], s=60, c="grey", alpha=0.35, label="goal")
    axes.set_title(f"Three parts brought home in {len(truth) * _scenario(recording).tick_s:.0f} s")
    _plane(axes)
    axes.set_xticks(np.arange(-1.0, 1.01, 0.5))
    axes.set_yticks(np.arange(-1.0, 1.01, 0.5))
    _legend(axes, 4)


def _draw_room(axes: Axes, recording: Recording) -> None:
    scenario = _scenario(recording)
    true, estimated = _series(recording, "truth/robot"), _series(recording, "estimator/state")
    reckoned = _series(recording, "estimator/dead_reckoning")
    for mark in scenario.landmarks:
        axes.annotate(str(mark.id), (mark.x, mark.y), xytext=(4, 4), textcoords="offset points", fontsize=7)
    marks = np.array([(mark.x, mark.y) for mark in scenario.landmarks])
    axes.plot(*marks.T, "k^", ms=6, ls="none", label="landmark")
    path = np.array([(one.pose.position.x, one.pose.position.y) for one in reckoned.messages])
    axes.plot(*path.T, color=RECKONED, lw=1.2, ls="--", label="odometry alone")
    axes.plot(*np.array([(one.x, one.y) for one in true.messages]).T, color=TRUE, lw=2.6, alpha=0.45, label="true path")
    places = np.array([(one.x, one.y) for one in estimated.messages])
    axes.plot(*places.T, color=ESTIMATED, lw=1.1, label="estimated path, particle filter")
    axes.plot(*places[0], "o", color=TRUE, ms=6, label="start")
    axes.plot(*path[-1], "x", color=RECKONED, ms=8, mew=2)
    axes.plot(*places[-1], "x", color=ESTIMATED, ms=8, mew=2)
    axes.plot([], [], "x", color="grey", mew=2, ls="none", label="end")
    axes.set_title(f"landmark-room: two rounds of a room ({true.stamps[-1]:.0f} s)")
    _plane(axes)
    _legend(axes, 3)


def _plane(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _legend(axes: Axes, columns: int) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=columns, frameon=False, fontsize=7.5)


def _series(recording: Recording, topic: str) -> Series:
    records = list(recording.messages(topic))
    stamps = np.array([record.stamp_ns * 1e-9 for record in records])
    return Series(stamps, [decode(topic, record.payload, recording.topics) for record in records])


def _scenario(recording: Recording) -> Scenario:
    return override_resolved(recording.header.scenario, (), str(recording.path))


def _run(name: str, folder: Path) -> Recording:
    scenario = load_scenario(name, seed=1)
    path = folder / f"{name}.mcap"
    record_inline(scenario, path)
    return read_recording(path)


def _main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        draw(_run("parts-3-easy", Path(folder)), _run("landmark-room", Path(folder)), PICTURE)


if __name__ == "__main__":
    _main()
