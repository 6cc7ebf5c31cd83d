"""The tube that a capsule drives through, from the scenario's ``[colon]`` and ``maps``; pixels and radians."""

from collections.abc import Sequence
from string import ascii_lowercase
from typing import Annotated, Literal

import msgspec
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.context import Context
from msgspec import Meta

from dynpf.colon.bore import bore
from dynpf.colon.maps import drawn_map, tube_map
from dynpf.colon.outline import Bulge, Family, tube
from dynpf.colon.world import ROUTE, Route
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.timeline import MapTimeline
from dynpf.motion.capsule import CapsuleMotion

__all__ = ["MOST_DRAWINGS", "BulgeConfig", "ColonConfig", "ColonWorld", "MapHolds", "RouteConfig", "colon_world"]

MOST_DRAWINGS = len(ascii_lowercase)

Reading = Annotated[int, Meta(ge=0)]
Pixels = Annotated[float, Meta(ge=-1e5, le=1e5)]
Size = Annotated[float, Meta(gt=0.0, le=1e4)]
Turn = Annotated[float, Meta(ge=-7.0, le=7.0)]


class MapHolds(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A map that holds from a reading on, until the next map holds."""

    # a: the plain tube; b: with a bulge near the end of the path; c: with a bulge elsewhere; "b 0.5": b's at half size;
    # "other 7": with a bulge drawn from the number; "end 105": with a round end of 105 px; or the name of ``bulges``.
    # With bitmaps: a, b, c and so on, in their order.
    map: str
    from_reading: Reading = 0  # 0: at the start, then one for each motion


class BulgeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A bulge of a wall of the plain tube; a map has all bulges with its name."""

    map: str  # the name of the map
    beyond_bend_px: Pixels  # px along the centre line from the beginning of the bend; negative: before it
    size_px: Size = 45.0  # px, height of the bulge
    width_px: Size = 38.0  # px along the wall, of a bell shape
    left: bool = False  # in the direction of travel; else on the right


class RouteConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The capsule's start and its commanded motions."""

    start: tuple[Pixels, Pixels, Turn] = ROUTE.start  # px, px, rad
    motions: tuple[tuple[Pixels, Turn], ...] = ()  # each: px ahead, after a turn by rad; empty: COLON's fifteen


class ColonConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A capsule in a tube whose walls change (COLON): a member of a family, or bitmaps of your own (``maps``)."""

    family: Literal["haustra", "folds", "irregular"] = "haustra"
    tube: Annotated[int, Meta(ge=0)] = 1  # the seed of the tube in its family
    bulges: tuple[BulgeConfig, ...] = ()  # further maps of the tube
    route: RouteConfig = RouteConfig()
    true: Annotated[tuple[MapHolds, ...], Meta(min_length=1)] = (MapHolds(map="a"),)  # in order of time
    told: Annotated[tuple[MapHolds, ...], Meta(min_length=1)] = (MapHolds(map="a"),)  # the schedule given to the filter


class ColonWorld:
    """The route, the maps and their schedules, as simulator, sensors and estimator share them.

    ``true`` and ``told`` are the schedules by number of reading, true and as given to the filter. Raises ScenarioError
    for contradictions.
    """

    def __init__(self, config: ColonConfig, drawings: Sequence[tuple[str, bytes]]) -> None:
        """Take the user's bitmaps in order, each with its file's name; without bitmaps the tube is generated."""
        motions = tuple(CapsuleMotion(*motion) for motion in config.route.motions)
        self.route = Route(config.route.start, motions or ROUTE.motions, ROUTE.change)
        self.true, self.told = _timeline(config.true, "colon.true"), _timeline(config.told, "colon.told")
        self._config = config
        self._drawings = dict(zip(ascii_lowercase, drawings, strict=False))
        self._grids: dict[str, OccupancyGrid] = {}

    def grid(self, name: str, key: str) -> OccupancyGrid:
        """Return a map by its name; raises ScenarioError, which names the scenario's ``key``."""
        if name not in self._grids:
            try:
                self._grids[name] = self._made(name)
            except ValueError as error:
                raise ScenarioError(f"{'maps' if name in self._drawings else key}: {error}") from error
        return self._grids[name]

    def true_grids(self) -> dict[str, OccupancyGrid]:
        """Return the maps that are true at some time, by name."""
        return {name: self.grid(name, "colon.true") for _, name in self.true.entries}

    def drawn(self) -> list[OccupancyGrid]:
        """Return the maps of the user's bitmaps; raises ScenarioError for the first that is not a map."""
        return [self.grid(name, "maps") for name in self._drawings]

    def _made(self, name: str) -> OccupancyGrid:
        route = self.route.poses()
        if self._drawings:
            if name not in self._drawings:
                raise ValueError(f"map {name!r}: the bitmaps of this run are called {', '.join(self._drawings)}")
            file, data = self._drawings[name]
            return drawn_map(data, file, route)
        config = self._config
        family = Family(config.family)
        own = [bulge for bulge in config.bulges if bulge.map == name]
        if not own:
            return tube_map(family, config.tube, name, route)
        plain = tube(family, config.tube)
        bulges = (Bulge(bulge.left, plain.bend + bulge.beyond_bend_px, bulge.size_px, bulge.width_px) for bulge in own)
        return bore(plain.bore(*bulges), route, name)


def colon_world(context: Context) -> ColonWorld:
    """Return the tube of a run with its maps and route; raises ScenarioError."""
    return context.once("tube", lambda: _world(context))


def _world(context: Context) -> ColonWorld:
    config = context.fact("colon")
    if config is None:
        raise ScenarioError(f"{context.name}: needs the table [colon] with the tube and when its maps hold")
    return ColonWorld(config, [(name, context.file(name, "maps")) for name in context.fact("maps") or ()])


def _timeline(held: tuple[MapHolds, ...], key: str) -> MapTimeline[str]:
    try:
        return MapTimeline(tuple((entry.from_reading, entry.map) for entry in held))
    except ValueError as error:
        raise ScenarioError(f"{key}: {error}") from error
