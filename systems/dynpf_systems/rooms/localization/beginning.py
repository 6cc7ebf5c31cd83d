"""The initial belief: a known pose, anywhere, or poses proposed by the first readings."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from dynpf_protocol.errors import ScenarioError

from dynpf.filters.models import Models
from dynpf.filters.start import FromReadingsStart, KnownStart, Start, UniformStart, around, pose_source
from dynpf.maps.occupancy import OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats
from dynpf_systems.rooms.maps import Maps

__all__ = ["Beginning", "doubts_of"]

REHEARSED_PARTICLES = 64


def doubts_of(start: Start, grid: OccupancyGrid | None) -> Iterator[str]:
    """Yield what is wrong with a known start on the run's map, if it has both, in words."""
    if not isinstance(start, KnownStart) or grid is None:
        return
    column, row = (math.floor(float(cell)) for cell in grid.to_cells(start.x, start.y))
    height, width = grid.cells.shape
    where = f"the start ({start.x:.2f}, {start.y:.2f}) m"
    if not (0 <= column < width and 0 <= row < height):
        corners = [grid.to_map(x, y) for x in (0, width) for y in (0, height)]
        (left, low), (right, high) = np.min(corners, axis=0), np.max(corners, axis=0)
        yield f"{where} lies outside the map, which is x {left:.2f} to {right:.2f}, y {low:.2f} to {high:.2f} m"
    elif grid.cells[row, column] == UNKNOWN:
        yield f"{where} lies in unknown space of the map"
    elif grid.cells[row, column] == OCCUPIED:
        yield f"{where} lies in a wall of the map"


class Beginning:
    """The start that a scenario asks for; raises ScenarioError, at the node's ``key``, where the run lacks a map."""

    def __init__(self, start: Start, maps: Maps, models: Models, key: str) -> None:
        self._start, self._grid = start, maps.grid
        try:
            self._source = None if isinstance(start, KnownStart) else pose_source(start, grid=maps.grid, models=models)
        except ValueError as error:
            raise ScenarioError(f"{key}.start: {error}") from error

    @property
    def pose(self) -> FloatArray | None:
        """The known pose (3,), or None."""
        start = self._start
        return np.array([start.x, start.y, start.theta]) if isinstance(start, KnownStart) else None

    def possible(self, readings: Sequence[Any]) -> bool:
        """Return whether these readings suffice to begin: a start from readings waits for the first ones."""
        return isinstance(self._start, KnownStart | UniformStart) or bool(readings)

    def poses(self, count: int, readings: Sequence[Any], stream: Stream) -> Floats:
        """Return poses (3, count) to begin with."""
        if self._source is None:
            assert isinstance(self._start, KnownStart)
            return around(self._start, count, stream)
        return self._source.draw(count, readings, stream)

    def rehearsed(self, stream: Stream) -> Floats:
        """Return poses (3, N), all equal, where a robot may be."""
        start = self._start
        if isinstance(start, KnownStart):
            poses = around(start, REHEARSED_PARTICLES, stream)
        else:
            base = start.base if isinstance(start, FromReadingsStart) else start
            anywhere = base if isinstance(base, UniformStart) else UniformStart()
            poses = pose_source(anywhere, grid=self._grid).draw(REHEARSED_PARTICLES, (), stream)
        poses[:] = poses[:, :1]
        return poses

    def rehearse(self, readings: Sequence[Any], stream: Stream) -> None:
        """Execute every code path of ``poses`` once, so that kernels are compiled."""
        if self._source is not None:
            self._source.draw(REHEARSED_PARTICLES, readings, stream)
