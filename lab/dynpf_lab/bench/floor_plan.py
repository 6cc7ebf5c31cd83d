"""A random office floor, the same at every call: 50 m x 35 m in cells of 5 cm, all known, with furniture."""

import numpy as np
from numpy.typing import NDArray

from dynpf.maps.occupancy import FREE, OCCUPIED, OccupancyGrid
from dynpf.rng import Draws, generator

__all__ = ["floor_plan"]

RESOLUTION_M = 0.05
WIDTH, HEIGHT = 1000, 700  # cells
OUTER_WALL, WALL, DOOR = 4, 3, 18
# The spans of the corridors across their directions: two from west to east, one from south to north.
EAST_WEST = ((180, 228), (472, 520))
NORTH_SOUTH = (476, 524)
# Rows of rooms: their span from south to north, and the side of the corridor.
ROOMS = ((0, 180, "north"), (228, 350, "south"), (350, 472, "north"), (520, 700, "south"))

Cells = NDArray[np.uint8]


def floor_plan() -> OccupancyGrid:
    """Return the floor: outer walls, corridors, rooms of 3 to 6.5 m with a door each, desks, cabinets and chairs."""
    rng = generator(0, "bench", 0, "floor plan")
    cells = np.full((HEIGHT, WIDTH), FREE, dtype=np.uint8)
    for south, north, corridor in ROOMS:
        for first, last in ((0, NORTH_SOUTH[0]), (NORTH_SOUTH[1], WIDTH)):
            for west, east in _rooms(first, last, rng):
                _room(cells[south:north, west:east], corridor, rng)
    cells[:OUTER_WALL] = cells[-OUTER_WALL:] = cells[:, :OUTER_WALL] = cells[:, -OUTER_WALL:] = OCCUPIED
    return OccupancyGrid(cells, RESOLUTION_M)


def _rooms(first: int, last: int, rng: Draws) -> list[tuple[int, int]]:
    walls = [first]
    while last - walls[-1] > 130:
        walls.append(walls[-1] + int(rng.integers(60, min(131, last - walls[-1] - 60))))
    return list(zip(walls, [*walls[1:], last], strict=True))


def _room(room: Cells, corridor: str, rng: Draws) -> None:
    """Draw walls, a door to the corridor, and furniture into a room's cells."""
    height, width = room.shape
    room[:WALL] = room[-WALL:] = room[:, :WALL] = room[:, -WALL:] = OCCUPIED
    door = int(rng.integers(2 * WALL, width - DOOR - 2 * WALL))
    room[slice(-WALL, None) if corridor == "north" else slice(0, WALL), door : door + DOOR] = FREE
    inside = room[WALL + 24 : height - WALL - 24, WALL : width - WALL]  # half a metre and more before every door
    for _ in range(int(rng.integers(1, 4))):
        _put(inside, (14, 28) if rng.random() < 0.5 else (28, 14), rng)  # desk
    for _ in range(int(rng.integers(1, 4))):
        _put(inside, (8, 8), rng)  # chair
    _put(inside, (24, 9), rng)  # cabinet


def _put(inside: Cells, size: tuple[int, int], rng: Draws) -> None:
    row, column = (int(rng.integers(0, space - part)) for space, part in zip(inside.shape, size, strict=True))
    inside[row : row + size[0], column : column + size[1]] = OCCUPIED
