"""A local origin for maps far from zero, such as those in UTM: particles are float32, and a filter works near zero.

At a northing of 3,900 km the step of a float32 is 0.25 m. So the maps, the start and the boxes of such a scenario are
moved by whole metres before the filter is built, positions that sensors tell are moved as they come, and what is
published is moved back.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.messages import InitialPose

from dynpf.filters.estimate import PoseEstimate
from dynpf.filters.start import FromReadingsStart, KnownStart, UniformStart
from dynpf.maps.landmarks import LandmarkMap
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.segments import SegmentMap
from dynpf.measurement.position import Position
from dynpf.measurement.range_bearing import RangeBearingReadings
from dynpf.se2 import FAR_M
from dynpf.types import FloatArray, Floats
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.localizers import Found
from dynpf_systems.rooms.maps import Maps

__all__ = ["LocalOrigin", "local_origin"]


class LocalOrigin(NamedTuple):
    """A point of the map, in whole metres, that the filter takes for zero."""

    x: float
    y: float

    def config(self, config: LocalizationConfig) -> LocalizationConfig:
        """Return the configuration with its start and its restart seen from here."""
        start, restart = self._start(config.start), self._start(config.restart)
        return msgspec.structs.replace(config, start=start, restart=restart)

    def maps(self, maps: Maps) -> Maps:
        """Return the maps seen from here."""
        marks, grid, segments = maps
        if marks is not None:
            marks = LandmarkMap((number, *(marks.position(number) - self).tolist()) for number in marks.ids)
        if grid is not None:
            x, y, yaw = grid.origin
            grid = OccupancyGrid(grid.cells, grid.resolution, (x - self.x, y - self.y, yaw))
        if segments is not None:
            segments = SegmentMap(segments.segments - np.array([*self, *self]))
        return Maps(marks, grid, segments)

    def reading(self, reading: Any) -> Any:
        """Return a reading seen from here, if it holds positions."""
        match reading:
            case Position(x=x, y=y):
                return Position(x - self.x, y - self.y)
            case RangeBearingReadings(places=places) if places is not None:
                return reading._replace(places=places - np.array(self)[:, None])
        return reading

    def told(self, pose: InitialPose) -> InitialPose:
        """Return a pose that somebody has told, seen from here."""
        return msgspec.structs.replace(pose, x=pose.x - self.x, y=pose.y - self.y)

    def published(self, found: Found) -> Found:
        """Return what was found, in the map's own coordinates."""
        mean, covariance = found.estimate
        return found._replace(estimate=PoseEstimate(self.poses(mean), covariance))

    def poses(self, poses: Floats) -> FloatArray:
        """Return poses (3, ...) in the map's own coordinates."""
        moved = np.array(poses, dtype=np.float64)
        moved[0] += self.x
        moved[1] += self.y
        return moved

    def _start(self, start: Any) -> Any:
        match start:
            case KnownStart(x=x, y=y):
                return msgspec.structs.replace(start, x=x - self.x, y=y - self.y)
            case UniformStart(box=box) if box is not None:
                moved = {name: getattr(box, name) - getattr(self, name[0]) for name in box.__struct_fields__}
                return msgspec.structs.replace(start, box=msgspec.structs.replace(box, **moved))
            case FromReadingsStart(base=base):
                return msgspec.structs.replace(start, base=self._start(base))
        return start


def local_origin(config: LocalizationConfig, maps: Maps) -> LocalOrigin | None:
    """Return the local origin of a scenario: where its map lies, or its start; None where that is near zero."""
    x, y = next(_places(config, maps), (0.0, 0.0))
    return LocalOrigin(float(round(x)), float(round(y))) if max(abs(x), abs(y)) >= FAR_M else None


def _places(config: LocalizationConfig, maps: Maps) -> Iterator[tuple[float, float]]:
    if maps.grid is not None:
        yield maps.grid.origin[:2]
    if maps.segments is not None:
        yield float(maps.segments.segments[0, 0]), float(maps.segments.segments[0, 1])
    if maps.landmarks is not None and len(maps.landmarks):
        first = maps.landmarks.positions[:, 0]
        yield float(first[0]), float(first[1])
    for start in (config.start, config.restart):
        base = start.base if isinstance(start, FromReadingsStart) else start
        if isinstance(base, KnownStart):
            yield base.x, base.y
        elif isinstance(base, UniformStart) and base.box is not None:
            yield base.box.x_min, base.box.y_min
