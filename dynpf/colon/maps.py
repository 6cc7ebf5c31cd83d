"""COLON's maps by their names, and anybody's drawings as such maps."""

from dynpf.colon.bore import bore
from dynpf.colon.outline import Bulge, Family, RoundEnd, Tube, tube
from dynpf.maps.bitmap import decode_bitmap
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.rng import generator
from dynpf.types import Floats

__all__ = ["NAMES", "drawn_map", "tube_map"]

NAMES = "a, b, c, 'b SHARE', 'other NUMBER', 'end RADIUS'"
"""The names that ``tube_map`` knows."""

_MOST = {"b": 1e3, "end": 1e4, "other": 2.0**62}


def tube_map(family: Family, seed: int, name: str, route: Floats) -> OccupancyGrid:
    """Return a map of a tube, around a route of poses (3, T), by its name.

    a: the plain tube; b: with a bulge near the end of the path; c: with one elsewhere; "b 0.5": b's at half its size;
    "other 7": with a bulge that the number 7 stands for; "end 105": with a round end of that radius in px. Raises
    ValueError for a name that means nothing, and where the route does not fit.
    """
    drawn = tube(family, seed)
    try:
        grid = _named(drawn, seed, name)
    except (KeyError, ValueError):
        raise ValueError(f"map {name!r}: expected one of {NAMES}") from None
    return bore(grid, route, name)


def _named(drawn: Tube, seed: int, name: str) -> OccupancyGrid:
    """Raises KeyError or ValueError for a name that means nothing."""
    kind, _, number = name.partition(" ")
    near_the_end = Bulge(False, drawn.bend + 25.0)
    if not number:
        return drawn.bore(*{"a": (), "b": (near_the_end,), "c": (Bulge(False, drawn.bend + 115.0),)}[name])
    if not 0.0 <= float(number) <= _MOST[kind]:
        raise ValueError
    if kind == "end":
        return drawn.round_ended(RoundEnd(float(number)))
    if kind == "other":
        random = generator(int(number), "studies", seed, "bulge")
        return drawn.bore(Bulge(False, drawn.bend + random.uniform(-20.0, 150.0), random.uniform(25.0, 50.0)))
    return drawn.bore({"b": near_the_end}[kind].grown(float(number)))


def drawn_map(data: bytes, name: str, route: Floats) -> OccupancyGrid:
    """Return the map in a PNG, BMP or PGM around a route of poses (3, T); pixels have whole coordinates, y upwards.

    Raises ValueError, beginning with ``name``, where it is no image and for what ``bore`` refuses.
    """
    return bore(decode_bitmap(data, name, origin=(-0.5, -0.5, 0.0), thicken=True), route, name)
