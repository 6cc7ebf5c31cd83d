"""Foreign maps as attachments of a recording: the YAML file of map_server and the image that it names."""

import os
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from dynpf.maps.map_server import decode
from dynpf.maps.occupancy import OccupancyGrid
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.text import refuse_pointer
from dynpf_formats.importers.transforms import matrix, planar
from dynpf_formats.recording.attachments import attached
from dynpf_formats.recording.header import Attachment
from dynpf_formats.regular_files import read_regular

__all__ = ["import_map", "map_attachments", "map_of_message"]

LARGEST_MAP = 2**28  # cells of a map in a message


def import_map(path: Path) -> ImportedLog:
    """Return a log without records, with the map of a map_server YAML file attached.

    Raises ImportFailedError if the file is no such map.
    """
    attachments, grid = _read(path)
    return ImportedLog(path.name, "map", _facts(grid), _nothing(), Losses(), attachments)


def map_attachments(path: Path) -> tuple[Attachment, ...]:
    """Return the YAML file and its image as attachments; raises ImportFailedError if the file is no map."""
    return _read(path)[0]


def map_of_message(message: Any, name: str) -> tuple[Attachment, ...]:
    """Return a ROS OccupancyGrid as the files of map_server, with equal cells; ``name`` is without suffix.

    Raises ValueError if the grid is no valid map.
    """
    width, height = int(message.info.width), int(message.info.height)
    cells = np.asarray(message.data, dtype=np.int8)
    pose = matrix(message.info.origin.position, message.info.origin.orientation)
    if pose is None:
        raise ValueError("its origin is not a pose of finite numbers")
    if not 0 < width * height <= LARGEST_MAP or cells.size != width * height:
        raise ValueError(f"{cells.size} cells in {width} x {height}")
    if not (np.isfinite(message.info.resolution) and message.info.resolution > 0.0):
        raise ValueError(f"its resolution is {message.info.resolution} m")
    x, y, yaw = planar(pose)
    pixels = cells.view(np.uint8).reshape(height, width)[::-1]  # -1, unknown, becomes 255
    text = (
        f"image: {name}.pgm\nmode: raw\nresolution: {float(message.info.resolution)!r}\n"
        f"origin: [{x!r}, {y!r}, {yaw!r}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    image = f"P5\n{width} {height}\n255\n".encode() + pixels.tobytes()
    return attached(f"{name}.yaml", text.encode()), attached(f"{name}.pgm", image)


def _read(path: Path) -> tuple[tuple[Attachment, ...], OccupancyGrid]:
    refuse_pointer(path)
    images: dict[str, bytes] = {}

    def read(name: str) -> bytes:
        images[PurePath(name).name] = data = read_regular(path.parent / os.path.expanduser(name))  # noqa: PTH111 - never raises
        return data

    try:
        text = read_regular(path).decode()
        grid = decode(text, read, path.name)
    except (OSError, UnicodeDecodeError) as error:
        raise ImportFailedError(f"{path}: cannot be read: {error}") from error
    except ValueError as error:
        raise ImportFailedError(f"{path.parent / str(error)}") from error
    return (attached(path.name, text.encode()), *(attached(name, data) for name, data in images.items())), grid


def _facts(grid: OccupancyGrid) -> dict[str, Any]:
    height, width = grid.cells.shape
    return {
        "width": width,
        "height": height,
        "resolution_m": grid.resolution,
        "origin": list(grid.origin),
        "occupied": int(grid.occupied.sum()),
        "free": int(grid.free.sum()),
    }


def _nothing() -> Iterator[Record]:
    yield from ()
