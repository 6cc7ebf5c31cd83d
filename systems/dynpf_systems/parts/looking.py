"""Moves by which the robot shows which of the discs it is: only it moves as commanded."""

import math
from typing import NamedTuple

import numpy as np

from dynpf.directions import directions
from dynpf.fields.clearance import disc_clearances, wall_clearances
from dynpf.fields.layout import Layout
from dynpf.types import FloatArray
from dynpf_systems.parts.beliefs import Scene
from dynpf_systems.parts.controller_config import RearrangementControllerConfig

__all__ = ["Look", "safe_direction"]

DIRECTIONS = 16
STAGES = (0.5, 1.0)  # of the move, at which clearances are looked at


class Look(NamedTuple):
    """A move and a wait behind it: the ticks left of both, and the step of each tick of the move, m."""

    ticks: int = 0
    dx: float = 0.0
    dy: float = 0.0

    def next(self, scene: Scene, layout: Layout, config: RearrangementControllerConfig, longest: float) -> "Look":
        """Return the look a tick later; when it is over, another in a direction that is safe now.

        ``longest`` is the longest step of a tick. Without a safe direction the robot only waits.
        """
        if self.ticks > 1:
            return self._replace(ticks=self.ticks - 1)
        distance = config.look_distance + config.look_sigmas * min(scene.robot_sigma, config.max_sigma)
        way = safe_direction(scene, layout, distance, config.margin)
        if way is None:
            return Look(config.look_ticks)
        moving = max(math.ceil(distance / longest), 1)
        dx, dy = (way * (distance / moving)).tolist()
        return Look(moving + config.look_ticks, dx, dy)

    def step(self, config: RearrangementControllerConfig) -> FloatArray:
        """Return the step of this tick, (3,)."""
        return np.array([self.dx, self.dy, 0.0]) if self.ticks > config.look_ticks else np.zeros(3)


def safe_direction(scene: Scene, layout: Layout, distance: float, margin: float) -> FloatArray | None:
    """Return the unit vector, (2,), along which whichever disc may be the robot moves with the greatest clearance.

    None where no move of ``distance`` leaves ``margin`` to everything else.
    """
    discs = np.vstack([scene.pose[:2], scene.parts])
    radii = np.append(layout.robot_radius, layout.radii)
    candidates = [0, *(part + 1 for part in scene.robot_among)]
    ways = directions(DIRECTIONS)
    spare = [
        min(_clearance(disc, discs[disc] + stage * distance * way, discs, radii, layout) for disc in candidates)
        for way in ways
        for stage in STAGES
    ]
    least = np.array(spare).reshape(len(ways), len(STAGES)).min(axis=1)
    best = int(least.argmax())
    return ways[best] if least[best] >= margin else None


def _clearance(disc: int, at: FloatArray, discs: FloatArray, radii: FloatArray, layout: Layout) -> float:
    others = np.arange(len(discs)) != disc
    to_discs = disc_clearances(at, float(radii[disc]), discs[others], radii[others])
    to_walls = wall_clearances(at, float(radii[disc]), layout.half_size)
    return float(min(to_discs.min(initial=np.inf), to_walls.min()))
