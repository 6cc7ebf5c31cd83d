"""Any drawing as a map: dark pixels are walls."""

import numpy as np
from numpy.typing import NDArray

from dynpf.maps.image import decode_image
from dynpf.maps.occupancy import OccupancyGrid, thickened
from dynpf.portable import whole

__all__ = ["decode_bitmap", "from_grey"]


def decode_bitmap(
    data: bytes,
    name: str,
    *,
    free_from: int = 128,
    resolution: float = 1.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    thicken: bool = False,
) -> OccupancyGrid:
    """Return the map drawn in a PNG, BMP or PGM; the colours count as their mean, and alpha not at all.

    ``name`` is what errors call the image; the rest as in ``from_grey``. Raises ValueError where it does not decode.
    """
    try:
        shades = decode_image(data)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    grey = whole(np.rint(255.0 * shades.colour), 0, 255, np.uint8)
    return from_grey(grey, free_from=free_from, resolution=resolution, origin=origin, thicken=thicken)


def from_grey(
    grey: NDArray[np.uint8],
    *,
    free_from: int = 128,
    resolution: float = 1.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    thicken: bool = False,
) -> OccupancyGrid:
    """Return the map whose walls are the pixels darker than ``free_from``; the rest is free and nothing unknown.

    ``grey``: shape (H, W), rows from the top; y of the map grows upwards. ``resolution``: metres a pixel, or one unit
    of whatever the drawing is measured in. ``origin``: pose of the lower left corner; (-0.5, -0.5, 0) gives the pixels
    whole coordinates, as COLON does. ``thicken`` makes a wall also of the eight neighbours of every wall pixel: COLON
    hits a wall where any pixel of a 3 x 3 block is not white (free_from = 255).
    """
    walls = grey[::-1] < free_from
    return OccupancyGrid.from_bools(thickened(walls) if thicken else walls, resolution, origin)
