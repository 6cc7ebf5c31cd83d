"""Figures of the study parts-vision. They need matplotlib, which the extra ``figures`` installs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row
from numpy.typing import NDArray

from dynpf.vision import DetectionParams, Disc, detect_discs, subsample
from dynpf.vision.background import estimate_background, flatten
from dynpf.vision.components import foreground, trace_borders
from dynpf_systems.parts.camera import DrawnDisc, board_discs, encode, render
from dynpf_systems.parts.camera_model import CameraParams, project
from dynpf_systems.parts.studies.disc_scenes import KINDS, draw_scene
from dynpf_systems.parts.studies.vision import CAMERAS, PHOTOGRAPH, calibrated_node, frame_errors, photograph

__all__ = ["draw"]

_FRAMES = 25  # of each camera, for the distribution of errors
_FOUND = "#d55e00"
_STYLES = ("-", "--", "-.", ":")


def draw(photographs: Sequence[str], seed: int, rows: list[Row], folder: Path) -> list[Path]:
    """Draw the stages of the detection, the discs found in scenes and photographs, and the errors; return the files.

    Raises UsageError where matplotlib is not installed.
    """
    pyplot = plotting()

    written = [
        _stages(pyplot, seed, folder / "stages.png"),
        _scenes(pyplot, seed, folder / "scenes.png"),
        _errors(pyplot, seed, folder / "errors.png"),
    ]
    if any("goals" in row for row in rows):
        written.append(_task(pyplot, rows, folder / "task.png"))
    if photographs:
        written.append(_photographs(pyplot, photographs, folder / "photographs.png"))
    return written


def _stages(pyplot: Any, seed: int, path: Path) -> Path:
    """Draw PARTS's Figure 5.3 for the camera with lens distortion: the stages from the frame to the circles."""
    camera = CAMERAS["lens and light"]
    assert camera.board is not None
    board = render(board_discs(camera.board, camera), camera, seed, 0)
    frame = cv2.imdecode(np.frombuffer(encode(_scene(camera, seed), camera), np.uint8), cv2.IMREAD_COLOR)
    assert frame is not None
    grey = subsample(np.asarray(frame, dtype=np.uint8))
    contrast = flatten(grey, estimate_background(grey))
    mask = foreground(contrast, DetectionParams().min_contrast)
    borders = trace_borders(mask, 20.0)
    figure, axes = pyplot.subplots(2, 3, figsize=(11, 6.4), layout="constrained")
    panels = axes.ravel()
    panels[0].imshow(board[::2, ::2, ::-1])
    panels[0].set_title("the first frame: the board")
    panels[1].imshow(frame[::2, ::2, ::-1])
    panels[1].set_title(f"a) colour frame, {frame.shape[1]} x {frame.shape[0]}")
    panels[2].imshow(grey, cmap="gray", vmin=0, vmax=255)
    panels[2].set_title(f"b) grey, {grey.shape[1]} x {grey.shape[0]}")
    panels[3].imshow(mask, cmap="gray")
    panels[3].set_title("c) threshold, freed of the light")
    edges = np.zeros_like(mask)
    x, y = borders.px.astype(int).T
    edges[y, x] = 255
    panels[4].imshow(edges, cmap="gray")
    panels[4].set_title("d) edges of the components")
    panels[5].imshow(grey, cmap="gray", vmin=0, vmax=255)
    _circles(panels[5], detect_discs(grey, DetectionParams()))
    panels[5].set_title("e) circles fitted")
    for axis in panels:
        axis.set(xticks=[], yticks=[])
    return _saved(pyplot, figure, path)


def _scene(camera: CameraParams, seed: int) -> NDArray[np.uint8]:
    """Return a frame with the robot and a part in its gripper, a part in a corner and a free part."""
    discs = [
        DrawnDisc(0.36, 0.18, 0.06, camera.part_colour),
        DrawnDisc(-0.84, 0.86, 0.11, camera.part_colour),
        DrawnDisc(0.62, -0.55, 0.08, camera.part_colour),
        DrawnDisc(0.21, 0.12, 0.10, camera.robot_colour, 0.38),
    ]
    return render(discs, camera, seed, 1)


def _scenes(pyplot: Any, seed: int, path: Path) -> Path:
    figure, axes = pyplot.subplots(2, 2, figsize=(9, 7.4), layout="constrained")
    for axis, kind in zip(axes.ravel(), KINDS, strict=True):
        scene = draw_scene(kind, seed, 1)
        found = detect_discs(scene.image, DetectionParams())
        axis.imshow(scene.image, cmap="gray", vmin=0, vmax=255)
        _circles(axis, found)
        axis.set(title=f"{kind}: {len(found)} found of {len(scene.discs)}", xticks=[], yticks=[])
    return _saved(pyplot, figure, path)


def _photographs(pyplot: Any, paths: Sequence[str], path: Path) -> Path:
    figure, axes = pyplot.subplots(1, len(paths), figsize=(5.5 * len(paths), 5), layout="constrained", squeeze=False)
    for axis, image_path in zip(axes[0], paths, strict=True):
        found = detect_discs(photograph(image_path), PHOTOGRAPH)
        colour = cv2.imread(image_path, cv2.IMREAD_COLOR)
        assert colour is not None
        axis.imshow(colour[..., ::-1])
        _circles(axis, found)
        axis.set(title=f"{Path(image_path).name}: {len(found)} discs", xticks=[], yticks=[])
    return _saved(pyplot, figure, path)


def _errors(pyplot: Any, seed: int, path: Path) -> Path:
    """Draw cumulative distributions of the errors in single frames by camera, and the lens distortion of a grid."""
    figure, axes = pyplot.subplots(1, 3, figsize=(12, 3.9), layout="constrained")
    for style, name in zip(_STYLES, CAMERAS, strict=True):
        camera = CAMERAS[name]
        node = calibrated_node(camera, seed)
        errors = np.concatenate([frame_errors(node, camera, seed, 1 + i)[0] for i in range(_FRAMES)])
        for axis, values in zip(axes, (np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])), strict=False):
            share = (np.arange(len(values)) + 1) / len(values)
            axis.step(1000.0 * np.sort(values), 100.0 * share, style, where="post", label=name)
    axes[0].set(xlabel="error of the centre (mm)", ylabel="share of discs (%)", title="centres")
    axes[1].set(xlabel="error of the radius (mm)", title="radii")
    axes[1].legend(loc="lower right")
    for axis in axes[:2]:
        axis.grid(alpha=0.3)
        axis.set_xlim(left=0.0)
    _bent_grid(axes[2])
    return _saved(pyplot, figure, path)


def _bent_grid(axis: Any) -> None:
    line, across = np.linspace(-1.0, 1.0, 50), np.linspace(-1.0, 1.0, 9)
    for name, colour, style in (("plain", "#888888", "--"), ("lens", _FOUND, "-")):
        camera = CAMERAS[name]
        for number, offset in enumerate(across):
            for points in (np.stack([line, 0 * line + offset], 1), np.stack([0 * line + offset, line], 1)):
                label = name if number == 0 and points[0, 0] == -1.0 and points[1, 0] > -1.0 else None
                axis.plot(*project(points, camera).T, style, color=colour, lw=0.9, label=label)
    axis.set(title="the workspace in the frame", xlabel="u (px)", ylabel="v (px)", aspect="equal")
    axis.invert_yaxis()
    axis.legend(loc="upper right")


def _task(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw errors at the end and during the run: a group of bars for each layout, a bar for each noise."""
    runs = [row for row in rows if row.get("goals") not in {None, "all"}]
    goals, noises = (list(dict.fromkeys(row[key] for row in runs)) for key in ("goals", "noise"))
    columns = (("final_error_cm", "final error (cm)"), ("rpee_cm", "rpee (cm)"), ("npl", "npl"))
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    for axis, (key, title) in zip(axes, columns, strict=True):
        for index, noise in enumerate(noises):
            chosen = [row for row in runs if row["noise"] == noise]
            at = np.array([goals.index(row["goals"]) for row in chosen]) + 0.8 * (index + 0.5) / len(noises) - 0.4
            shade = str(0.25 + 0.5 * index / max(len(noises) - 1, 1))
            axis.bar(at, [row[f"{key}_mean"] for row in chosen], 0.8 / len(noises), color=shade, label=noise)
        axis.set(title=title, xticks=range(len(goals)), xticklabels=goals, xlabel="goals")
        axis.grid(alpha=0.3, axis="y")
    axes[0].legend(title="noise")
    return _saved(pyplot, figure, path)


def _circles(axis: Any, discs: Sequence[Disc]) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 90)
    limits = axis.get_xlim(), axis.get_ylim()
    for disc in discs:
        x, y = disc.x_px + disc.radius_px * np.cos(angle), disc.y_px + disc.radius_px * np.sin(angle)
        axis.plot(x, y, color="black", lw=2.6)
        axis.plot(x, y, color="#f0e442", lw=1.4)
        axis.plot(disc.x_px, disc.y_px, "+", color="#f0e442", ms=6)
    axis.set(xlim=limits[0], ylim=limits[1])


def _saved(pyplot: Any, figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=80)
    pyplot.close(figure)
    return path
