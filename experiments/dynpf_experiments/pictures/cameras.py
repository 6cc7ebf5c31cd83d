"""Camera frames as thumbnails, with the circles that a system draws over them."""

import base64
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from dynpf_protocol.messages import CompressedImage

from dynpf.image_size import is_whole, size_of
from dynpf_experiments.pictures.columns import evenly
from dynpf_experiments.pictures.drawing import Circle
from dynpf_experiments.pictures.source import RunSource

__all__ = ["Camera", "Frame", "as_uri", "cameras_of"]

MOST_PIXELS = 40_000_000
"""Of a frame that is decoded; an image of some bytes may claim billions."""

MOST_CIRCLES = 64
WIDTH_PX = 320
QUALITY = 55


class Frame(NamedTuple):
    """A thumbnail: time, s, a JPEG, and circles in its pixels."""

    seconds: float
    jpeg: bytes
    circles: list[Circle]


class Camera(NamedTuple):
    """The frames of a topic that are shown, and how many were recorded."""

    topic: str
    width: int
    height: int
    frames: list[Frame]
    told: int


def cameras_of(source: RunSource, circles: Mapping[str, Callable[[int], Sequence[Circle]]]) -> list[Camera]:
    """Return the cameras of a run, with thumbnails at even distances; frames that are no images are left out."""
    topics = source.carrying(CompressedImage)[:4]
    return [_camera(source, topic, source.budget.frames // len(topics), circles.get(topic)) for topic in topics]


def _camera(source: RunSource, topic: str, most: int, circles: Callable[[int], Sequence[Circle]] | None) -> Camera:
    records = source.records(topic)
    frames: list[Frame] = []
    width, height = 0, 0
    for index in evenly(len(records), most).tolist():
        message = source.decoded(records[index])
        made = _thumbnail(message.data) if isinstance(message, CompressedImage) else None
        if made is None or (frames and made[1:3] != (width, height)):
            continue
        jpeg, width, height, factor = made
        over = [] if circles is None else circles(records[index].stamp_ns)[:MOST_CIRCLES]
        drawn = [Circle(*(value / factor for value in circle)) for circle in over]
        frames.append(Frame(float(source.seconds([records[index]])[0]), jpeg, drawn))
    return Camera(topic, width, height, frames, len(records))


def _thumbnail(data: bytes) -> tuple[bytes, int, int, int] | None:
    """Return a JPEG of some WIDTH_PX, its width and height, and how many times smaller it is; None for no image."""
    size = size_of(data)
    if size is None or not is_whole(data) or size[0] * size[1] > MOST_PIXELS or min(size) < 1:
        return None
    factor = next((each for each in (4, 2) if size[0] >= each * WIDTH_PX), 1)
    flags = {4: cv2.IMREAD_REDUCED_COLOR_4, 2: cv2.IMREAD_REDUCED_COLOR_2, 1: cv2.IMREAD_COLOR}
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags[factor])
        if image is None:
            return None
        stride = -(-image.shape[1] // (2 * WIDTH_PX))
        small = np.ascontiguousarray(image[::stride, ::stride])
        done, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    except cv2.error:
        return None
    return (bytes(jpeg), small.shape[1], small.shape[0], factor * stride) if done else None


def as_uri(jpeg: bytes) -> str:
    """Return a JPEG as the address of an image that holds it."""
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode('ascii')}"
