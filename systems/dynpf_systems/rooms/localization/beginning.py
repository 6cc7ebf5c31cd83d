"""The initial belief: a known pose, anywhere, or poses proposed by the first readings."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dynpf_protocol.errors import ScenarioError

from dynpf.filters.models import Models
from dynpf.filters.start import FromReadingsStart, KnownStart, Start, UniformStart, around, pose_source
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats
from dynpf_systems.rooms.maps import Maps

__all__ = ["Beginning"]

REHEARSED_PARTICLES = 64


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
