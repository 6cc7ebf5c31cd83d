"""Tubes: closed, ridged, curved bores that hold COLON's path, in seeded families, with bulges and round ends.

COLON's drawings are lost; what its text says of them is kept: 1057 x 721 pixels, a closed and ridged outline around the
path, a change in one region near the end of the path, and an end that is a circle of given radius. A bore is the strip
between two walls left and right of a centre line; a family says how the walls are ridged.
"""

import math
from enum import StrEnum
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import cos, exp, hypot, sin, whole
from dynpf.rng import Draws, generator
from dynpf.types import FloatArray

__all__ = ["HEIGHT", "UNIT", "WIDTH", "Bulge", "Family", "RoundEnd", "Tube", "tube"]

WIDTH, HEIGHT = 1057, 721
"""Size of a map in pixels (COLON, myPFmap)."""
UNIT = 30.0
"""Pixels to the unit in which COLON gives the radii of round ends; it does not say: our choice."""

_SPACING = 3.0  # px along the centre line
_SUBPIXEL_BITS = 4
_WALL_OFF = 80.0  # px from the centre line, about
# Where the centre line begins, turns upwards, and ends; the path goes along y = 370 and turns at x = 820.
_LEFT, _AXIS, _BEND, _BEND_RADIUS, _TOP = 60.0, 370.0, 740.0, 85.0, 575.0


class Family(StrEnum):
    """How the walls of a tube are ridged."""

    HAUSTRA = "haustra"  # lobes between equidistant creases, both walls alike
    FOLDS = "folds"  # narrow folds that reach in from either wall by turns
    IRREGULAR = "irregular"  # each wall its own random waves


class Bulge(NamedTuple):
    """A place where a wall stands out: by ``size`` px at ``place`` px along the centre line, a bell of
    ``width`` px along the wall."""

    left: bool
    place: float
    size: float = 45.0
    width: float = 38.0

    def grown(self, share: float) -> "Bulge":
        """Return the bulge at a share of its size."""
        return self._replace(size=share * self.size)


class RoundEnd(NamedTuple):
    """The tube ends, without a bend, in a circle; px."""

    radius: float
    x: float = 820.0
    y: float = 400.0


class Tube(NamedTuple):
    """One tube: its centre line (2, M), and its half widths to the left and to the right of it, each (M,); px."""

    centre: FloatArray
    left: FloatArray
    right: FloatArray

    @property
    def bend(self) -> float:
        """Where along the centre line the bend begins."""
        return float(_along(self.centre)[np.searchsorted(self.centre[0], _BEND - 1.0)])

    def bore(self, *bulges: Bulge) -> OccupancyGrid:
        """Return the map of the tube with bulges: free within, occupied elsewhere; one unit a pixel, centres whole."""
        along, normal = _along(self.centre), _normals(self.centre)
        left, right = self.left.copy(), self.right.copy()
        for bulge in bulges:
            # Measured along the wall, smoothed: on the outer side of a bend it is longer than the centre line.
            wall = self.centre + _WALL_OFF * normal * (1.0 if bulge.left else -1.0)
            along_wall = _along(wall)
            away = along_wall - _between(bulge.place, along, along_wall)
            side = left if bulge.left else right
            side += bulge.size * exp(-0.5 * np.square(away / bulge.width))
        return _grid(_strip(self.centre, left, right))

    def round_ended(self, end: RoundEnd) -> OccupancyGrid:
        """Return the map of the tube up to its bend, with a circle behind."""
        straight = self.centre[0].argmax() if self.centre[0].max() < _BEND else np.searchsorted(self.centre[0], _BEND)
        kept = slice(0, int(straight))
        strip = _strip(self.centre[:, kept], self.left[kept], self.right[kept])
        disc = np.zeros_like(strip)
        centre = [round(coordinate * 2**_SUBPIXEL_BITS) for coordinate in (end.x, end.y)]
        cv2.circle(disc, centre, round(end.radius * 2**_SUBPIXEL_BITS), 1, -1, cv2.LINE_8, _SUBPIXEL_BITS)
        return _grid(strip | disc)


def tube(family: Family, seed: int) -> Tube:
    """Return a member of a family; every one holds COLON's path, at least 10 px off the walls."""
    random = generator(seed, "tube", 0, family.value)
    centre = _centre_line(bow=random.uniform(-16.0, 16.0), waves=random.uniform(1.0, 2.5), phase=random.uniform(0, 7))
    along = _along(centre)
    half = random.uniform(72.0, 88.0)
    period = random.uniform(75.0, 115.0)
    phase = random.uniform(0.0, 2.0 * np.pi)
    if family is Family.HAUSTRA:
        lobes = random.uniform(16.0, 24.0) * (np.abs(sin(np.pi * along / period + phase)) - 0.6)
        left = right = half + lobes
    elif family is Family.FOLDS:
        folds = [_folds(along, period, random.uniform(0.0, period), random.uniform(16.0, 24.0)) for _ in range(2)]
        left, right = half + 6.0 - folds[0], half + 6.0 - folds[1]
    else:
        left, right = (half + _waves(along, random) for _ in range(2))
    cap = _cap(along, half)
    return Tube(centre, left * cap, right * cap)


def _centre_line(bow: float, waves: float, phase: float) -> FloatArray:
    """Return points (2, M) along the axis, slightly bowed, around the bend, and up."""
    x = _steps(_LEFT, _BEND, _SPACING)
    fade = np.square(np.clip((_BEND - x) / 120.0, 0.0, 1.0)) * (3.0 - 2.0 * np.clip((_BEND - x) / 120.0, 0.0, 1.0))
    straight = np.stack((x, _AXIS + bow * fade * sin(waves * np.pi * (x - _LEFT) / (_BEND - _LEFT) + phase)))
    angle = _steps(0.0, 0.5 * np.pi, _SPACING / _BEND_RADIUS)
    bend = np.stack((_BEND + _BEND_RADIUS * sin(angle), _AXIS + _BEND_RADIUS * (1.0 - cos(angle))))
    y = _steps(_AXIS + _BEND_RADIUS, _TOP, _SPACING)
    return np.concatenate((straight, bend, np.stack((np.full(y.size, _BEND + _BEND_RADIUS), y))), axis=1)


def _steps(start: float, end: float, step: float) -> FloatArray:
    """Return numbers from ``start`` on, ``step`` apart, up to before ``end``."""
    count = math.ceil((end - start) / step)
    return start + step * np.arange(count).astype(np.float64)


def _between(place: float, places: FloatArray, values: FloatArray) -> float:
    """Return what lies at a place between values (M,) at ascending places (M,), linearly; beyond, the first or last."""
    after = int(np.searchsorted(places, place, side="right"))
    if after in (0, places.size):
        return float(values[0 if after == 0 else -1])
    share = (place - places[after - 1]) / (places[after] - places[after - 1])
    return float(values[after - 1] + share * (values[after] - values[after - 1]))


def _along(line: FloatArray) -> FloatArray:
    """Return the length of a line (2, M) up to each of its points."""
    return np.append(0.0, np.cumsum(hypot(*np.diff(line))))


def _normals(line: FloatArray) -> FloatArray:
    """Return unit vectors (2, M) to the left of a line."""
    ends = np.pad(line, ((0, 0), (1, 1)), mode="edge")
    x, y = ends[:, 2:] - ends[:, :-2]  # central differences, at both ends one-sided
    normals: FloatArray = np.stack((-y, x)) / hypot(x, y)
    return normals


def _folds(along: FloatArray, period: float, start: float, depth: float) -> FloatArray:
    distance = (along - start + 0.5 * period) % period - 0.5 * period
    return depth * exp(-0.5 * np.square(distance / 9.0))


def _waves(along: FloatArray, random: Draws) -> FloatArray:
    """Return waves of random lengths and phases, at most 18 px."""
    lengths, phases = random.uniform(45.0, 220.0, 5), random.uniform(0.0, 2.0 * np.pi, 5)
    shares = random.shares(5)
    waves: FloatArray = 18.0 * np.sum(
        shares[:, None] * sin(2.0 * np.pi * along / lengths[:, None] + phases[:, None]), axis=0
    )
    return waves


def _cap(along: FloatArray, half: float) -> FloatArray:
    """Return the factor that rounds both ends."""
    to_end = np.minimum(along, along[-1] - along).clip(max=half) / half
    cap: FloatArray = np.sqrt(1.0 - np.square(1.0 - to_end))
    return cap


def _strip(centre: FloatArray, left: FloatArray, right: FloatArray) -> NDArray[np.uint8]:
    """Return 1 where a pixel lies between the walls, uint8 (H, W): quadrilaterals between neighbouring points."""
    normal = _normals(centre)
    walls = np.stack((centre + left * normal, centre - right * normal))
    corners = whole(np.rint(walls * 2**_SUBPIXEL_BITS), -(2**31), 2**31 - 1, np.int32)
    strip = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    for i in range(centre.shape[1] - 1):
        quad = np.stack((corners[0, :, i], corners[0, :, i + 1], corners[1, :, i + 1], corners[1, :, i]))
        cv2.fillConvexPoly(strip, cv2.convexHull(quad), (1,), cv2.LINE_8, _SUBPIXEL_BITS)
    return strip


def _grid(bore: NDArray[np.uint8]) -> OccupancyGrid:
    return OccupancyGrid.from_bools(bore == 0, 1.0, (-0.5, -0.5, 0.0))
