"""Two rooms of different furniture with a door between, and scans as they would be seen there."""

from typing import Any

import numpy as np

from dynpf.filters.models import Models
from dynpf.filters.search import Search, SearchStart
from dynpf.filters.start import pose_source
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.scan import Scan
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.se2 import wrap_angle

FIELD = LikelihoodFieldParams(sigma_hit=0.1, tempering=0.3)
START = SearchStart(spacing=0.3, kept=500)
RANGE_MAX = 6.0


def flat(yaw: float = 0.0, origin: tuple[float, float] = (1.0, -2.0)) -> OccupancyGrid:
    """Two rooms of different furniture, 8 m by 5 m in cells of 5 cm, with a door between; the outside is unknown."""
    cells = np.full((120, 180), 2, dtype=np.uint8)
    cells[10:110, 10:170] = 0
    for rows, columns in (
        ((10, 110), (10, 12)),
        ((10, 110), (168, 170)),
        ((10, 12), (10, 170)),
        ((108, 110), (10, 170)),
    ):
        cells[slice(*rows), slice(*columns)] = 1
    cells[10:70, 90:92] = cells[86:110, 90:92] = 1
    cells[12:30, 12:24] = cells[60:70, 40:66] = cells[80:108, 150:160] = 1
    return OccupancyGrid(cells, 0.05, (*origin, yaw))


def seen(grid: OccupancyGrid, pose: Any, beams: int = 90) -> Scan:
    angles = np.linspace(-2.0, 2.0, beams, dtype=np.float32)
    x, y, theta = (np.full(beams, one) for one in pose)
    return Scan(angles, RayCaster(grid).ranges(x, y, theta + angles, RANGE_MAX), 0.0, RANGE_MAX)


def search_of(grid: OccupancyGrid, params: SearchStart = START) -> Search:
    models = Models(OdometryMotion(OdometryParams()), {Scan: LikelihoodField(FIELD, grid)})
    source = pose_source(params, grid=grid, models=models)
    assert isinstance(source, Search)
    return source


def in_map(grid: OccupancyGrid, along: float, across: float, turn: float) -> np.ndarray[Any, Any]:
    x, y = grid.to_map(along / grid.resolution, across / grid.resolution)
    return np.array([x, y, wrap_angle(turn + grid.origin[2])])
