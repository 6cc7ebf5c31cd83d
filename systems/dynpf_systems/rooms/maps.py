"""The map of a run: the table ``[map]`` of a scenario, and what the algorithms take; metres and radians."""

from collections.abc import Callable, Iterable
from typing import Annotated, NamedTuple

import cv2
import msgspec
import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_services.scenario.context import Context
from msgspec import Meta

from dynpf.maps.bitmap import decode_bitmap
from dynpf.maps.landmarks import LandmarkMap
from dynpf.maps.map_server import decode
from dynpf.maps.occupancy import UNKNOWN, OccupancyGrid
from dynpf.maps.segments import SegmentMap
from dynpf.types import Positive

__all__ = [
    "NO_MAPS",
    "BitmapConfig",
    "MapConfig",
    "Maps",
    "OccupancyConfig",
    "SegmentsConfig",
    "maps_of",
    "named_file",
    "open_maps",
]

Segment = tuple[float, float, float, float]
Pose = tuple[float, float, float]


class OccupancyConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="occupancy"
):
    """An occupancy grid as ROS keeps it: a YAML file of map_server, and the image that it names."""

    file: str  # the YAML file, seen from the scenario's folder; a recording carries its content


class BitmapConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="bitmap"
):
    """A drawing whose dark pixels are walls: PNG, BMP or PGM."""

    file: str  # the image, seen from the scenario's folder; a recording carries its content
    resolution: Positive = 0.05  # m a pixel
    origin: Pose = (0.0, 0.0, 0.0)  # m, m, rad: where the lower left corner lies in the map
    free_from: Annotated[int, Meta(ge=1, le=255)] = 128  # pixels darker than this grey level are walls
    thicken: bool = False  # the eight neighbours of a wall's pixel are walls, too


class SegmentsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="segments"
):
    """Straight walls (TURTLEBOT). Models that need a grid get one whose occupied cells are those that a wall crosses.

    What lies outside of closed walls is unknown in it, the rest is free.
    """

    segments: Annotated[tuple[Segment, ...], Meta(min_length=1, max_length=100_000)]  # x1, y1, x2, y2 in m
    resolution: Positive = 0.05  # m a cell of the grid


MapConfig = OccupancyConfig | BitmapConfig | SegmentsConfig


class Maps(NamedTuple):
    """A run's maps; None where the scenario has no such map."""

    landmarks: LandmarkMap | None = None
    grid: OccupancyGrid | None = None
    segments: SegmentMap | None = None


NO_MAPS = Maps()


def open_maps(config: MapConfig | None, landmarks: Iterable[Landmark] | None, read: Callable[[str], bytes]) -> Maps:
    """Return the maps of a run; ``read`` returns a file's content by its path, relative to that of ``config.file``.

    Raises ValueError for content that is no such map, and whatever ``read`` raises for the map's own file.
    """
    marks = None if landmarks is None else LandmarkMap((mark.id, mark.x, mark.y) for mark in landmarks)
    match config:
        case OccupancyConfig(file=file):
            name = file.rpartition("/")[2]
            try:
                text = read(name).decode()
            except UnicodeDecodeError as error:
                raise ValueError(f"{name}: not a YAML file: {error}") from None
            return Maps(marks, grid=decode(text, read, name))
        case BitmapConfig(file=file):
            name = file.rpartition("/")[2]
            grid = decode_bitmap(
                read(name),
                name,
                free_from=config.free_from,
                resolution=config.resolution,
                origin=config.origin,
                thicken=config.thicken,
            )
            return Maps(marks, grid=grid)
        case SegmentsConfig():
            segments = SegmentMap(config.segments)
            return Maps(marks, grid=_grid_of(segments, config.resolution), segments=segments)
        case None:
            return Maps(marks)


def named_file(config: MapConfig | None) -> str | None:
    """Return the file that a table [map] names, or None."""
    return config.file if isinstance(config, OccupancyConfig | BitmapConfig) else None


def maps_of(context: Context) -> Maps:
    """Return the maps of a run from files read with its scenario; raises ScenarioError."""
    return context.once("maps", lambda: _opened(context))


def _opened(context: Context) -> Maps:
    landmarks = context.fact("landmarks") or (() if context.scenario.needs_log else None)
    try:
        return open_maps(context.fact("map"), landmarks, lambda path: context.file(path, "map.file"))
    except ValueError as error:
        raise ScenarioError(f"map: {error}") from error


def _grid_of(segments: SegmentMap, resolution: float) -> OccupancyGrid:
    """Return the grid whose occupied cells are those that a wall runs through; outside of closed walls it is unknown.

    The margin puts walls at whole multiples of the resolution in the middle of cells, where a grid takes them to be.
    """
    grid = segments.rasterize(resolution, margin=1.5 * resolution)
    labels = cv2.connectedComponents(
        (~grid.occupied).astype(np.uint8, casting="safe"), connectivity=4, ltype=cv2.CV_32S
    )[1]
    outside = labels == labels[0, 0]
    if np.array_equal(outside, grid.free):  # the walls are open: there is no outside
        return grid
    return OccupancyGrid(np.where(outside, np.uint8(UNKNOWN), grid.cells), grid.resolution, grid.origin)
