"""Draws docs/run.png, the picture in the README: `python -m docs.figures`.

Runs parts-3-easy and landmark-room with seed 1, in one process. The worlds are drawn as those of `dynpf plot` are;
beside them is a camera frame with the discs that were found in it.
"""

import tempfile
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from dynpf_experiments.pictures.whole import Whole, whole
from dynpf_experiments.plots.style import RC
from dynpf_experiments.plots.world import draw_bodies, draw_map, draw_paths, frame
from dynpf_formats.recording.reader import Recording
from dynpf_lab.notebook import read, run
from dynpf_protocol.messages import CompressedImage
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

__all__ = ["draw"]

PICTURE = Path(__file__).with_name("run.png")
DPI = 110
CAMERA = "camera/image"
FOUND = "#f0e442"


def draw(parts: Recording, room: Recording, path: Path) -> None:
    """Draw a run of parts-3-easy and one of landmark-room, side by side, into a PNG file."""
    settings: dict[Any, Any] = {**RC, "savefig.dpi": DPI}
    with mpl.rc_context(settings):
        figure = Figure(figsize=(14.0, 4.8), dpi=DPI, layout="constrained")
        camera, paths, rounds = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.42])
        brought, driven = whole(parts), whole(room)
        _draw_camera(camera, brought)
        _draw_world(paths, brought, f"Three parts brought home in {brought.seconds:.0f} s")
        _draw_world(rounds, driven, f"landmark-room: two rounds of a room ({driven.seconds:.0f} s)")
        figure.savefig(path, metadata={"Software": "dynpf"})
    with Image.open(path) as image:
        image.convert("RGB").save(path, optimize=True)


def _draw_world(axes: Axes, drawn: Whole, title: str) -> None:
    draw_map(axes, drawn)
    draw_paths(axes, drawn)
    draw_bodies(axes, drawn)
    frame(axes, drawn)
    axes.set_title(title)
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, frameon=False)


def _draw_camera(axes: Axes, drawn: Whole) -> None:
    """Draw the frame in the middle of the run, with the discs of its time."""
    records = drawn.source.records(CAMERA)
    record = records[len(records) // 2]
    message = drawn.source.decoded(record)
    assert isinstance(message, CompressedImage)
    picture = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    axes.imshow(picture[::2, ::2, ::-1], extent=(-0.5, picture.shape[1] - 0.5, picture.shape[0] - 0.5, -0.5))
    for circle in drawn.drawing.circles[CAMERA](record.stamp_ns):
        for colour, width in (("black", 3.2), (FOUND, 1.8)):
            axes.add_patch(Circle((circle.u, circle.v), circle.radius, fill=False, color=colour, lw=width))
    axes.plot([], [], "o", ms=9, mfc="none", mec="#b8a800", mew=2, label="discs found by vision")
    axes.set_title(f"parts-3-easy: the camera's view at {(record.stamp_ns - drawn.source.origin_ns) * 1e-9:.1f} s")
    axes.set_xlabel("u (px)")
    axes.set_ylabel("v (px)")
    axes.grid(visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), frameon=False)


def _main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{name}.mcap" for name in ("parts-3-easy", "landmark-room")]
        parts, room = (read(run(path.stem, seed=1, path=path).path).recording for path in paths)
        draw(parts, room, PICTURE)


if __name__ == "__main__":
    _main()
