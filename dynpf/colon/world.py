"""COLON's experiment: the route, the maps of its five cases, and a capsule that moves and reads five ranges."""

import math
from typing import NamedTuple

import msgspec
import numpy as np

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.maps.timeline import MapTimeline
from dynpf.motion.capsule import CapsuleMotion
from dynpf.params import validated
from dynpf.portable import atan2, hypot, sincos
from dynpf.rng import Draws, generator
from dynpf.types import FloatArray, NonNegative, Share

__all__ = [
    "BEAMS",
    "CASES",
    "RANGE_MAX",
    "ROUTE",
    "Capsule",
    "Case",
    "Route",
    "Run",
    "blown",
    "is_free",
    "moved",
    "read_ranges",
    "simulate",
    "steered",
    "timeline",
]

BEAMS = tuple(math.radians(degrees) for degrees in (-60.0, -30.0, 0.0, 30.0, 60.0))
"""Directions of the five range finders, rad from the heading."""
RANGE_MAX = 500.0
"""px: where ranges are capped."""


class Route(NamedTuple):
    """Where the capsule starts, how it moves, and before which motion the maps change (COLON's t5)."""

    start: tuple[float, float, float]
    motions: tuple[CapsuleMotion, ...]
    change: int

    def poses(self) -> FloatArray:
        """Return the poses (3, T + 1) of a capsule that moves without noise, headings not wrapped."""
        poses = [np.array(self.start)]
        for motion in self.motions:
            poses.append(moved(poses[-1], motion))
        return np.stack(poses, axis=1)


ROUTE = Route(
    (150.0, 370.0, 0.0),
    tuple(
        CapsuleMotion(rho, turn)
        for rho, turn in (
            *[(100.0, 0.0)] * 4,
            *[(50.0, 0.0)] * 3,
            *[(20.0, 0.0)] * 3,
            (10.0, 0.0),
            (20.0, 0.0),
            (30.0, 0.0),
            (20.0, 0.5 * math.pi),
            (20.0, 0.0),
        )
    ),
    change=7,
)
"""COLON, myPF.m: from (150, 370, 0) to (820, 410, pi/2)."""


class Case(NamedTuple):
    """The map that becomes true at the change, and the one reported to the filter; before, both are "a"."""

    true: str
    told: str


CASES = {1: Case("a", "a"), 2: Case("b", "a"), 3: Case("b", "b"), 4: Case("a", "b"), 5: Case("c", "b")}
"""Static; the map changes unnoticed; both change; only the model changes; the map changes to one that is in no list."""


def timeline(before: str, *after: str, route: Route = ROUTE) -> MapTimeline[str]:
    """Return which map holds at which reading (0: at the start): ``before``, and those ``after`` the change in turn.

    Each of them holds for one reading, the last one from then on.
    """
    first = route.change + 1
    steps = [(0.0, before), *((float(first + i), name) for i, name in enumerate(after))]
    return MapTimeline(tuple(step for i, step in enumerate(steps) if i == 0 or step[1] != steps[i - 1][1]))


class Capsule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How well the true capsule moves and reads. COLON's does both without noise."""

    sigma: NonNegative = 0.0  # px, of x and of y, a motion
    sigma_theta: NonNegative = 0.0  # rad a motion
    sigma_range: NonNegative = 0.0  # px
    outlier_fraction: Share = 0.0  # share of ranges that are anything up to the cap


class Run(NamedTuple):
    """What happened: poses (3, T + 1), the motions asked for, ranges (B, T + 1), and the map's name at each reading."""

    poses: FloatArray
    motions: tuple[CapsuleMotion, ...]
    ranges: FloatArray
    maps: tuple[str, ...]


def simulate(
    casters: dict[str, RayCaster], true: MapTimeline[str], capsule: Capsule, seed: int, route: Route = ROUTE
) -> Run:
    """Return a run of the capsule; ``casters`` by the names in ``true``, whose times are numbers of readings.

    A capsule that moves with noise is steered: each motion heads for the route's next place from where the capsule
    is, as far as it is away. Where noise would take it into a wall it is drawn again, and at the 20th time left out.
    Raises ValueError for a parameter out of range.
    """
    validated(capsule)
    random = generator(seed, "capsule", 0)
    goals = route.poses()
    noisy = capsule.sigma > 0.0 or capsule.sigma_theta > 0.0
    poses, motions, ranges, maps = [goals[:, 0]], [], [], []
    for step in range(len(route.motions) + 1):
        caster = casters[true.at(step)]
        if step > 0:
            motion = steered(poses[-1], goals[:, step]) if noisy else route.motions[step - 1]
            motions.append(motion)
            poses.append(blown(poses[-1], motion, capsule, caster.grid, random))
        maps.append(true.at(step))
        ranges.append(read_ranges(caster, poses[-1], capsule, random))
    return Run(np.stack(poses, axis=1), tuple(motions), np.stack(ranges, axis=1), tuple(maps))


def moved(pose: FloatArray, motion: CapsuleMotion) -> FloatArray:
    """Return a pose (3,) after a motion without noise (COLON, myPFmotion); the heading is not wrapped."""
    heading = float(pose[2] + motion.turn)
    sine, cosine = sincos(heading)
    return np.array([pose[0] + motion.rho * cosine, pose[1] + motion.rho * sine, heading])


def steered(pose: FloatArray, goal: FloatArray) -> CapsuleMotion:
    """Return the motion from a pose (3,) to the place of another, whatever heading that leaves."""
    x, y = (goal[:2] - pose[:2]).tolist()
    return CapsuleMotion(hypot(x, y), math.remainder(atan2(y, x) - pose[2], 2.0 * math.pi))


def blown(pose: FloatArray, motion: CapsuleMotion, capsule: Capsule, grid: OccupancyGrid, random: Draws) -> FloatArray:
    """Return the pose (3,) after a motion with the capsule's noise, where a map leaves room for it."""
    sigmas = np.array([capsule.sigma, capsule.sigma, capsule.sigma_theta])
    aimed = moved(pose, motion)
    for _ in range(20):
        there = aimed + sigmas * random.standard_normal(3)
        if is_free(grid, there):
            return there
    return aimed


def is_free(grid: OccupancyGrid, pose: FloatArray) -> bool:
    """Return whether a pose (3,), or a place (2,), lies inside the tube of a map."""
    column, row = (int(cell) for cell in grid.to_cells(pose[0], pose[1]))
    height, width = grid.cells.shape
    return 0 <= row < height and 0 <= column < width and bool(grid.free[row, column])


def read_ranges(caster: RayCaster, pose: FloatArray, capsule: Capsule, random: Draws) -> FloatArray:
    """Return the ranges (B,) that the capsule reads at a pose (3,) in a map."""
    angles = pose[2] + np.array(BEAMS)
    exact = caster.ranges(np.full(angles.size, pose[0]), np.full(angles.size, pose[1]), angles, RANGE_MAX)
    read = np.clip(exact + capsule.sigma_range * random.standard_normal(angles.size), 0.0, RANGE_MAX)
    anything = random.uniform(size=angles.size) < capsule.outlier_fraction
    ranges: FloatArray = np.where(anything, random.uniform(0.0, RANGE_MAX, angles.size), read)
    return ranges
