"""Messages in Foxglove's shapes that no node publishes: maps, and points in the plane of the map."""

from typing import ClassVar

import cv2
import msgspec
import numpy as np
from dynpf_protocol.messages import CompressedImage, Pose, Quaternion, Timestamp, Vector3, planar_pose
from numpy.typing import NDArray

from dynpf.maps.occupancy import FREE, OCCUPIED, OccupancyGrid
from dynpf.types import FloatArray

__all__ = ["Grid", "PackedElementField", "PointCloud", "Vector2", "grid_of", "picture_of", "points_of"]

MAP_FRAME = "map"
UINT8, FLOAT32 = 1, 7
"""Numbers of element types in Foxglove's schemas."""

_SHADES = {FREE: 255, OCCUPIED: 0}
_UNKNOWN_SHADE = 160
_IDENTITY = Pose(position=Vector3(), orientation=Quaternion())


class Vector2(msgspec.Struct, frozen=True, kw_only=True):
    """Two lengths, m."""

    x: float
    y: float


class PackedElementField(msgspec.Struct, frozen=True, kw_only=True):
    """A field of packed data: its name, offset in bytes and type."""

    name: str
    offset: int
    type: int


class Grid(msgspec.Struct, frozen=True, kw_only=True):
    """Cells in a plane: row 0 lies at the pose, columns along its x axis; metres."""

    schema_name: ClassVar[str] = "foxglove.Grid"
    timestamp: Timestamp
    frame_id: str
    pose: Pose
    column_count: int
    cell_size: Vector2
    row_stride: int
    cell_stride: int
    fields: tuple[PackedElementField, ...]
    data: bytes


class PointCloud(msgspec.Struct, frozen=True, kw_only=True):
    """Points in a frame; metres."""

    schema_name: ClassVar[str] = "foxglove.PointCloud"
    timestamp: Timestamp
    frame_id: str
    pose: Pose
    point_stride: int
    fields: tuple[PackedElementField, ...]
    data: bytes


def grid_of(grid: OccupancyGrid, stamp: Timestamp) -> Grid:
    """Return a map as coloured cells: walls dark, free light, what is unknown is transparent."""
    shades = _shades(grid)
    cells = np.empty((*shades.shape, 4), dtype=np.uint8)
    cells[..., :3] = shades[..., np.newaxis]
    cells[..., 3] = np.where((grid.cells == FREE) | grid.occupied, 255, 0)
    x, y, yaw = grid.origin
    side = Vector2(x=grid.resolution, y=grid.resolution)
    return Grid(
        timestamp=stamp,
        frame_id=MAP_FRAME,
        pose=planar_pose(x, y, yaw),
        column_count=cells.shape[1],
        cell_size=side,
        row_stride=4 * cells.shape[1],
        cell_stride=4,
        fields=tuple(
            PackedElementField(name=name, offset=offset, type=UINT8)
            for offset, name in enumerate(("red", "green", "blue", "alpha"))
        ),
        data=cells.tobytes(),
    )


def picture_of(grid: OccupancyGrid, stamp: Timestamp) -> CompressedImage:
    """Return a map as an image, its y axis upwards."""
    done, data = cv2.imencode(".png", _shades(grid)[::-1])
    assert done
    return CompressedImage(timestamp=stamp, frame_id="map image", data=data.tobytes(), format="png")


def points_of(points: FloatArray, stamp: Timestamp) -> PointCloud:
    """Return points (2, M) of the map's plane, m."""
    packed = np.zeros((points.shape[1], 3), dtype="<f4")
    packed[:, :2] = points.T
    return PointCloud(
        timestamp=stamp,
        frame_id=MAP_FRAME,
        pose=_IDENTITY,
        point_stride=12,
        fields=tuple(
            PackedElementField(name=name, offset=4 * index, type=FLOAT32) for index, name in enumerate(("x", "y", "z"))
        ),
        data=packed.tobytes(),
    )


def _shades(grid: OccupancyGrid) -> NDArray[np.uint8]:
    shades: NDArray[np.uint8] = np.full(grid.cells.shape, _UNKNOWN_SHADE, dtype=np.uint8)
    for value, shade in _SHADES.items():
        shades[grid.cells == value] = shade
    return shades
