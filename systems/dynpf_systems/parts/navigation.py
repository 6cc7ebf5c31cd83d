"""The navigation construction: potentials solved by fast marching, from the current estimate.

A potential is solved again when the estimate it was solved for has changed. The potential in use follows from that
estimate, so the estimate is the state, and the potential is recomputed from it.
"""

import math
from typing import NamedTuple

import numpy as np
from dynpf_runtime.node import State
from numpy.typing import NDArray

from dynpf.directions import directions
from dynpf.fields.descent import approach_step, carry_step, dock_step
from dynpf.fields.laws import Pace
from dynpf.fields.layout import Layout
from dynpf.fields.navigation import (
    ANGLES,
    Cost,
    Obstacles,
    Potential,
    carrying_potential,
    crossed_parts,
    robot_potential,
    spare,
)
from dynpf.fields.placing import free_place
from dynpf.fields.potentials import next_part_gradient
from dynpf.portable import atan2, dist, norm, sincos
from dynpf.types import FloatArray
from dynpf_systems.parts.beliefs import Motion, Scene, Subtask, margins_of
from dynpf_systems.parts.controller_config import RearrangementControllerConfig

__all__ = ["NavigationConstruction"]


class _Basis(NamedTuple):
    """The problem of a potential: the part, the goal of part or robot, and the obstacles."""

    part: int
    goal: FloatArray
    obstacles: Obstacles


class _Solved(NamedTuple):
    basis: _Basis
    potential: Potential


class _Way(NamedTuple):
    """A subtask, and the weighted length of the path with the part."""

    subtask: Subtask
    carried: float


class NavigationConstruction:
    """Potentials of path lengths around obstacles; it keeps the last ones with the estimates they were solved for."""

    progress = 0.005  # metres of path

    def __init__(self, config: RearrangementControllerConfig, layout: Layout, pace: Pace) -> None:
        self._config, self._layout, self._pace = config, layout, pace
        self._cost = Cost(config.near, config.near_weight)
        self._mating: _Solved | None = None
        self._moving: _Solved | None = None

    # --- next-part ---------------------------------------------------------------------------------------------

    def choose(
        self, scene: Scene, away: NDArray[np.intp], stalls: NDArray[np.int64], *, make_way: bool
    ) -> Subtask | None:
        """Choose the part of steepest descent with a path home; if there is none, a part that makes way for the first.

        Parts that have stalled come after all others.
        """
        steepness = norm(next_part_gradient(scene.parts, self._layout, self._config.next_exponent), axis=1)
        for level in np.unique(stalls[away]).tolist():
            ranked = sorted(away[stalls[away] == level].tolist(), key=lambda part: -steepness[part])
            for part in ranked:
                if way := self._way(scene, part, self._layout.goals[part]):
                    return way.subtask
            for part in ranked if make_way else ():
                if subtask := self._make_way(scene, part):
                    return subtask
        return None

    def _way(self, scene: Scene, part: int, goal: FloatArray, *, parked: bool = False) -> _Way | None:
        """Return the subtask with the grip direction of the cheapest total path; None without a path."""
        layout, position = self._layout, scene.parts[part]
        moving, _ = self._moving_potential(scene, part, goal)
        states = np.column_stack([np.tile(position, (ANGLES.size, 1)), ANGLES])
        carried = np.where(moving.reached(states), moving.at(states), np.inf)
        if not np.isfinite(carried).any():
            return None
        others = self._obstacles(scene, layout.others(part))
        gripper = directions(ANGLES.size)
        contacts = position - layout.grip_distance(part) * gripper
        approaches = contacts - self._standoff(scene, part) * gripper
        room = np.minimum(*(spare(points, layout.robot_radius, others) for points in (contacts, approaches)))
        reaching = robot_potential(
            layout.robot_radius, self._obstacles(scene, np.arange(len(scene.parts))), scene.pose[:2], self._cost
        )
        states = np.column_stack([approaches, ANGLES])
        reached = np.where(reaching.reached(states), reaching.at(states), np.inf)
        cost = np.where(room >= 0.0, reached + self._config.carrying_weight * carried, np.inf)
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            return None
        return _Way(Subtask(part, goal, parked, float(ANGLES[best])), float(carried[best]))

    def _make_way(self, scene: Scene, part: int) -> Subtask | None:
        """Return the subtask that parks a part in the way of ``part``; None if none of them can be parked.

        It minimizes the total path of parts: to the parking position, of ``part`` to its goal, and back. If no single
        parking opens a path for ``part``, it is the first possible one.
        """
        layout, others = self._layout, self._layout.others(part)
        crossed = crossed_parts(
            layout,
            part,
            np.stack([scene.pose[:2], scene.parts[part]]),
            obstacles=self._obstacles(scene, others),
            indices=others,
            goal=layout.goals[part],
            cost=self._cost,
            arm=self._arm(part),
        )
        spots = [
            (blocker, spot)
            for blocker in crossed
            if scene.sigmas[blocker] <= self._config.lost_sigma
            for gap in self._config.parking_gaps
            if (spot := free_place(scene.parts, blocker, layout, gap)) is not None
        ]
        straight = [dist(scene.parts[blocker], spot) + dist(spot, layout.goals[blocker]) for blocker, spot in spots]
        own = dist(scene.parts[part], layout.goals[part])
        best, least = None, math.inf
        for index in sorted(range(len(spots)), key=straight.__getitem__):
            if straight[index] + own >= least:  # no path is shorter than the straight line
                break
            blocker, spot = spots[index]
            opened = scene._replace(parts=scene.parts.copy())
            opened.parts[blocker] = spot
            parking = self._way(scene, blocker, spot, parked=True)
            way = self._way(opened, part, layout.goals[part]) if parking else None
            if parking is None or way is None:
                continue
            carried = parking.carried + way.carried + dist(spot, layout.goals[blocker])
            if carried < least:
                best, least = parking.subtask, carried
        ways = (self._way(scene, *spot, parked=True) for spot in spots)
        return best or next((way.subtask for way in ways if way), None)

    # --- mate-part and move-part ----------------------------------------------------------------------------------

    def mate(self, scene: Scene, subtask: Subtask) -> Motion | None:
        """Go to the position before contact in the chosen direction; once the gripper is turned, go straight in."""
        part, robot = subtask.part, scene.pose[:2]
        margins = margins_of(scene, self._config)
        offset = scene.parts[part] - robot
        standoff = self._standoff(scene, part)
        to_go = norm(offset) - self._layout.grip_distance(part)
        bearing = atan2(float(offset[1]), float(offset[0]))
        blur = self._config.blur_sigmas * scene.bearing_sigma(part, self._config.max_sigma)
        aside = abs(math.remainder(bearing - subtask.direction, math.tau)) - blur
        turned = abs(math.remainder(bearing - scene.pose[2], math.tau)) - blur <= self._config.grip_angle
        if turned and aside <= self._config.dock_angle and to_go <= standoff + self._config.dock_slack:
            margins.parts[part] = self._layout.reach
            step = dock_step(robot, scene.parts, part, self._layout, margins=margins, pace=self._pace)
            return Motion(np.append(step, 0.0), to_go)
        sine, cosine = sincos(subtask.direction)
        direction = np.array([cosine, sine])
        goal = scene.parts[part] - (self._layout.grip_distance(part) + standoff) * direction
        potential, renewed = self._mating_potential(scene, part, goal)
        state = np.append(robot, 0.0)[None, :]
        if not potential.reached(state)[0]:
            return None
        step = approach_step(
            potential, robot, scene.parts, self._layout, margins=margins, pace=self._pace, to_go=abs(to_go)
        )
        beyond = standoff + self._config.dock_slack
        return Motion(np.append(step, 0.0), beyond + float(potential.at(state)[0]), renewed)

    def move(self, scene: Scene, subtask: Subtask) -> Motion:
        """See Construction."""
        part = subtask.part
        potential, renewed = self._moving_potential(scene, part, subtask.goal)
        margins = margins_of(scene, self._config)
        step = carry_step(potential, scene.pose, scene.parts, part, self._layout, margins=margins, pace=self._pace)
        state = np.append(self._layout.held_position(scene.pose, part), scene.pose[2])
        return Motion(step, float(potential.at(state[None, :])[0]), renewed)

    # --- potentials ------------------------------------------------------------------------------------------------

    def freeze(self) -> State:
        """Return the problems of the potentials in use."""
        return {name: _frozen(solved) for name, solved in (("mating", self._mating), ("moving", self._moving))}

    def thaw(self, state: State) -> None:
        """Solve the potentials of what freeze returned."""
        mating, moving = _thawed(state["mating"]), _thawed(state["moving"])
        self._mating = None if mating is None else self._solve_mating(mating)
        self._moving = None if moving is None else self._solve_moving(moving)

    def _mating_potential(self, scene: Scene, part: int, goal: FloatArray) -> tuple[Potential, bool]:
        basis = _Basis(part, goal, self._obstacles(scene, np.arange(len(scene.parts))))
        known = self._mating
        renewed = known is None or self._moved(known.basis, basis, scene)
        self._mating = self._solve_mating(basis) if known is None or renewed else known
        return self._mating.potential, renewed

    def _moving_potential(self, scene: Scene, part: int, goal: FloatArray) -> tuple[Potential, bool]:
        basis = _Basis(part, goal, self._obstacles(scene, self._layout.others(part)))
        known = self._moving
        renewed = known is None or self._moved(known.basis, basis, scene)
        self._moving = self._solve_moving(basis) if known is None or renewed else known
        return self._moving.potential, renewed

    def _solve_mating(self, basis: _Basis) -> _Solved:
        return _Solved(basis, robot_potential(self._layout.robot_radius, basis.obstacles, basis.goal, self._cost))

    def _solve_moving(self, basis: _Basis) -> _Solved:
        arm = self._arm(basis.part)
        retreat = self._config.leave_gap + self._config.closed
        given = (self._layout, basis.part, basis.obstacles, basis.goal, self._cost)
        return _Solved(basis, carrying_potential(*given, arm=arm, retreat=retreat))

    def _moved(self, old: _Basis, new: _Basis, scene: Scene) -> bool:
        """Return whether ``new`` differs from ``old`` in the task, or in a position by more than its noise."""
        if old.part != new.part or len(old.obstacles.kept) != len(new.obstacles.kept):
            return True
        config = self._config
        sigmas = np.delete(scene.sigmas, new.part) if len(new.obstacles.kept) < len(scene.sigmas) else scene.sigmas
        moved = norm(new.obstacles.centres - old.obstacles.centres, axis=1)
        kept = [*(new.obstacles.kept - old.obstacles.kept), *(new.obstacles.half_size - old.obstacles.half_size)]
        return bool(
            np.any(moved > config.anew + config.anew_sigmas * sigmas)
            or np.any(np.abs(kept) > config.anew)
            or dist(old.goal, new.goal) > 0.5 * config.anew
        )

    def _obstacles(self, scene: Scene, parts: NDArray[np.intp]) -> Obstacles:
        config = self._config
        closed = config.closed + config.closed_sigmas * scene.sigmas_between(config.max_sigma)
        wall = config.closed + config.closed_sigmas * min(scene.robot_sigma, config.max_sigma)
        return Obstacles(scene.parts[parts], self._layout.radii[parts] + closed[parts], self._layout.half_size - wall)

    def _standoff(self, scene: Scene, part: int) -> float:
        """Return the distance before contact from which the robot goes straight in."""
        config = self._config
        return config.standoff + config.closed_sigmas * float(scene.sigmas_between(config.max_sigma)[part])

    def _arm(self, part: int) -> float:
        return self._pace.arm * self._layout.grip_distance(part)


def _frozen(solved: _Solved | None) -> State | None:
    if solved is None:
        return None
    part, goal, obstacles = solved.basis
    return {"part": part, "goal": goal.copy(), **{name: array.copy() for name, array in obstacles._asdict().items()}}


def _thawed(state: State | None) -> _Basis | None:
    if state is None:
        return None
    obstacles = Obstacles(*(state[name].copy() for name in Obstacles._fields))
    return _Basis(state["part"], state["goal"].copy(), obstacles)
