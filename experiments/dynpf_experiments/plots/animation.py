"""A run as it goes, from above: a GIF, or an MP4 by OpenCV's own encoder."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from dynpf_protocol.errors import UsageError
from dynpf_runtime.progress import Share
from numpy.typing import NDArray

from dynpf_experiments.extras import plotting
from dynpf_experiments.pictures.whole import Whole
from dynpf_experiments.plots.style import RC
from dynpf_experiments.plots.world import draw_map, draw_paths, draw_robots, frame

__all__ = ["animate"]

MOST_PICTURES = 150
PICTURES_A_SECOND = 15
SIZE_INCHES, DPI = (6.4, 5.6), 100


def animate(run: Whole, path: Path) -> None:
    """Write a run of any length as at most 150 pictures, 10 s; raises UsageError where the file cannot be written."""
    moments = np.linspace(0.0, run.seconds, min(MOST_PICTURES, max(2, int(run.seconds * PICTURES_A_SECOND))))
    if path.suffix == ".gif":
        _gif(run, moments.tolist(), path)
    else:
        _mp4(run, moments.tolist(), path)


def _gif(run: Whole, moments: list[float], path: Path) -> None:
    from PIL import Image  # noqa: PLC0415 - comes with matplotlib

    pictures = [Image.fromarray(picture) for picture in _pictures(run, moments)]
    first, *others = [picture.quantize(64) for picture in pictures]
    first.save(path, save_all=True, append_images=others, duration=1000 // PICTURES_A_SECOND, loop=0)


def _mp4(run: Whole, moments: list[float], path: Path) -> None:
    size = tuple(int(side * DPI) for side in SIZE_INCHES)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), PICTURES_A_SECOND, size)
    if not writer.isOpened():
        raise UsageError(f"{path}: OpenCV cannot write an MP4 here; write a .gif instead")
    try:
        for picture in _pictures(run, moments):
            writer.write(np.ascontiguousarray(picture[:, :, ::-1]))
    finally:
        writer.release()


def _pictures(run: Whole, moments: list[float]) -> Iterator[NDArray[np.uint8]]:
    pyplot = plotting()
    with pyplot.rc_context(dict(RC)):
        drawn, axes = pyplot.subplots(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
        try:
            for at in _shown(moments):
                axes.clear()
                draw_map(axes, run, at)
                draw_paths(axes, run, at)
                frame(axes, run)
                draw_robots(axes, run, at)
                axes.set_title(f"{at:.1f} s", loc="left")
                yield _rendered(drawn)
        finally:
            pyplot.close(drawn)


def _shown(moments: list[float]) -> Iterator[float]:
    """Yield the moments, showing how many pictures are drawn."""
    with Share(len(moments), "pictures") as progress:
        for done, at in enumerate(moments):
            progress.show(done)
            yield at


def _rendered(drawn: Any) -> NDArray[np.uint8]:
    drawn.canvas.draw()
    return np.asarray(drawn.canvas.buffer_rgba(), dtype=np.uint8)[..., :3].copy()
