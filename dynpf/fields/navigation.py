"""Navigation potentials: the shortest weighted way to go, without local minima, for a robot alone or with a part.

V solves |grad V| = s(c), where c is the clearance left to obstacles and walls beyond what must be kept: s = 1 in the
open, more near obstacles, infinite where a step would use up the clearance. Since V is the length of the cheapest way
(weighted by s), it falls along that way from everywhere that can be reached. For a robot with a part in its gripper
the states are (b_x, b_y, theta) of the part, with the metric ||db||^2 + (arm dtheta)^2. Metres and radians.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.directions import directions
from dynpf.fields.layout import Layout
from dynpf.portable import norm, whole
from dynpf.types import FloatArray

__all__ = [
    "ANGLES",
    "Cost",
    "Obstacles",
    "Potential",
    "carrying_potential",
    "crossed_parts",
    "robot_potential",
    "spare",
]

Float32Array = NDArray[np.float32]

ANGLES = 2.0 * np.pi / 36 * np.arange(36)
"""The gripper directions at which potentials of a robot with a part are solved."""

ROBOT_SPACING, CARRYING_SPACING = 0.0125, 0.03  # between nodes
SEEDED = 2.0  # spacings about the goal in which the way is taken to be straight
FRINGE = 0.06  # how deep into closed space values go on, so that a state that has got there finds out again
BEYOND = 10.0  # their rise a metre
CROSSING = 6.0  # slowness of driving through parts, when it is asked which one is in the way
TIP = 0.01  # rounds off the potential at the goal
FAR = 1e3
CORNERS = np.indices((2, 2, 2)).reshape(3, 8)  # of the cell between nodes that a state lies in


class Obstacles(NamedTuple):
    """Discs with ``centres`` (n, 2), and ``kept`` (n,): radius and the clearance that must be kept from each.

    ``half_size`` (2,) is that of the workspace, less the clearance that must be kept from its walls.
    """

    centres: FloatArray
    kept: FloatArray
    half_size: FloatArray


class Cost(NamedTuple):
    """s = 1 + weight (1 - c / near)^2 where the clearance c beyond what must be kept is less than ``near``."""

    near: float
    weight: float

    def slowness(self, spare_clearance: Float32Array) -> Float32Array:
        """Return s, of the same shape; infinite where the clearance is negative."""
        short = np.maximum(np.float32(1.0) - spare_clearance / np.float32(self.near), np.float32(0.0))
        slow: Float32Array = np.float32(1.0) + np.float32(self.weight) * short * short
        slow[spare_clearance < 0.0] = np.inf
        return slow


@dataclass(frozen=True)
class Potential:
    """V at the nodes of a grid, and between them; ``values`` float32 (X, Y, T), infinite where there is no way.

    States have shape (N, 3): x, y and the gripper's direction, which a robot alone has no use for. Around the goal V is
    a distance, which is not linear between nodes, but V / distance is: that is what is interpolated.
    """

    values: Float32Array
    slowness: Float32Array
    depths: NDArray[np.int8]
    lower: FloatArray  # (2,) of node (0, 0)
    spacing: float
    goal: FloatArray

    @cached_property
    def _ratios(self) -> Float32Array:
        x, y = _axes(self.lower, self.spacing, self.values.shape)
        distance = np.sqrt(np.square(x[:, None] - self.goal[0]) + np.square(y - self.goal[1]) + TIP * TIP)
        ratios: Float32Array = self.values / distance.astype(np.float32)[:, :, None]
        return ratios

    @cached_property
    def _frame(self) -> Float32Array:
        turns = self.values.shape[2] / (2.0 * np.pi)
        return np.array([*self.lower, 1.0 / self.spacing, turns, *self.goal, TIP], dtype=np.float32)

    def at(self, states: FloatArray) -> FloatArray:
        """Return V at states (N, 3), shape (N,); infinite where there is no way or no workspace near."""
        columns = np.ascontiguousarray(states.T, dtype=np.float32)
        found = np.empty(len(states), dtype=np.float32)
        kernels.fields.interpolate(self._ratios, self._frame, columns[0], columns[1], columns[2], found)
        return found.astype(np.float64)

    def gradient(self, state: FloatArray, arm: float) -> FloatArray:
        """Return the gradient with respect to (x, y, arm theta), (3,), over half a node's spacing to both sides.

        Where there is no value on one side, from the other side alone; zero where there is none on either.
        """
        turn = np.pi / self.values.shape[2] if self.values.shape[2] > 1 else 1.0
        reach = np.array([0.5 * self.spacing, 0.5 * self.spacing, turn])
        offsets = np.concatenate([np.zeros((1, 3)), np.diag(reach), -np.diag(reach)])
        values = self.at(state + offsets)
        here, ahead, behind = values[0], values[1:4], values[4:7]
        if not np.isfinite(here):
            return np.zeros(3)
        both = np.isfinite(ahead).astype(float) + np.isfinite(behind)
        rise = np.where(np.isfinite(ahead), ahead, here) - np.where(np.isfinite(behind), behind, here)
        slope: FloatArray = rise / (np.maximum(both, 1.0) * reach * np.array([1.0, 1.0, arm]))
        return slope

    def reached(self, states: FloatArray) -> NDArray[np.bool_]:
        """Return whether there is a way to the goal from each of the states (N, 3), shape (N,).

        A state in the fringe of closed space has one if no open node beside it is without one.
        """
        size_x, size_y, size_t = self.values.shape
        x, y = ((states[:, axis] - self.lower[axis]) / self.spacing for axis in (0, 1))
        i, j = (whole(position, 0, size - 2)[:, None] for position, size in ((x, size_x), (y, size_y)))
        k = whole(np.floor(states[:, 2] * (size_t / (2.0 * np.pi))) % size_t, 0, size_t - 1)[:, None]
        at = i + CORNERS[0], j + CORNERS[1], (k + CORNERS[2]) % size_t
        depth = self.depths[at]
        pocket = (depth < 0) & np.isfinite(self.slowness[at])
        found: NDArray[np.bool_] = (depth == 0).any(axis=1) | ((depth > 0).any(axis=1) & ~pocket.any(axis=1))
        return found


def spare(points: FloatArray, radius: float, obstacles: Obstacles) -> Float32Array:
    """Return the clearance of a disc at ``points`` (..., 2) beyond what must be kept, float32, shape (...)."""
    x, y = (np.ascontiguousarray(points[..., axis], dtype=np.float32).reshape(-1) for axis in (0, 1))
    return _spare(x, y, radius, obstacles).reshape(points.shape[:-1])


def robot_potential(radius: float, obstacles: Obstacles, goal: FloatArray, cost: Cost) -> Potential:
    """Return the potential of a disc of ``radius`` on its way to ``goal``, (2,)."""
    x, y, lower = _grid(obstacles.half_size, ROBOT_SPACING)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    slowness = cost.slowness(spare(points, radius, obstacles))[:, :, None]
    at_goal = cost.slowness(np.maximum(spare(goal[None, :], radius, obstacles), np.float32(0.0)))
    return _solved(slowness, at_goal, lower, ROBOT_SPACING, goal, arm=1.0)


def carrying_potential(
    layout: Layout, held: int, obstacles: Obstacles, goal: FloatArray, cost: Cost, *, arm: float, retreat: float
) -> Potential:
    """Return the potential of a robot that carries part ``held`` to ``goal``, (2,).

    It ends at the gripper directions at which both fit there and the robot can back off by ``retreat``.
    """
    slowness, lower = _carrying_slowness(layout, held, obstacles, cost)
    gripper = directions(ANGLES.size)
    robots = goal - layout.grip_distance(held) * gripper
    left = spare(robots - retreat * gripper, layout.robot_radius, obstacles)
    fits = np.minimum(spare(robots, layout.robot_radius, obstacles), left)
    fits = np.minimum(fits, spare(goal[None, :], float(layout.radii[held]), obstacles))
    return _solved(slowness, cost.slowness(fits), lower, CARRYING_SPACING, goal, arm=arm)


def crossed_parts(
    layout: Layout,
    part: int,
    robot_and_part: FloatArray,
    *,
    obstacles: Obstacles,
    indices: NDArray[np.intp],
    goal: FloatArray,
    cost: Cost,
    arm: float,
) -> list[int]:
    """Return the parts in the way of the robot to ``part``, and of both from there to ``goal``, in that order.

    They are those that the cheapest way crosses when parts, but not walls, can be driven through at great cost.
    ``robot_and_part``: where they are, (2, 2). ``indices`` (n,) names the obstacles; ``part`` is not among them.
    """
    x, y, lower = _grid(obstacles.half_size, ROBOT_SPACING)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    walls = Obstacles(np.zeros((0, 2)), np.zeros(0), obstacles.half_size)
    radius = layout.robot_radius
    slowness = _passable(cost.slowness(spare(points, radius, obstacles)), cost.slowness(spare(points, radius, walls)))[
        :, :, None
    ]
    mating = _solved(slowness, np.ones(1, dtype=np.float32), lower, ROBOT_SPACING, robot_and_part[1], arm=1.0)
    way = mating.lower + ROBOT_SPACING * _downhill(mating, np.append(robot_and_part[0], 0.0))[:, :2]
    crossed = _touched(way, radius, obstacles)

    slowness, lower = _carrying_slowness(layout, part, obstacles, cost)
    slowness = _passable(slowness, _carrying_slowness(layout, part, walls, cost)[0])
    moving = _solved(slowness, np.ones(ANGLES.size, dtype=np.float32), lower, CARRYING_SPACING, goal, arm=arm)
    starts = np.column_stack([np.tile(robot_and_part[1], (ANGLES.size, 1)), ANGLES])
    nodes = _downhill(moving, starts[np.argmin(moving.at(starts))])
    parts = lower + CARRYING_SPACING * nodes[:, :2]
    robots = parts - layout.grip_distance(part) * directions(ANGLES.size)[nodes[:, 2]]
    for position, carrier in zip(parts, robots, strict=True):
        crossed += _touched(position[None, :], float(layout.radii[part]), obstacles)
        crossed += _touched(carrier[None, :], radius, obstacles)
    return [int(indices[index]) for index in dict.fromkeys(crossed)]


def _passable(slowness: Float32Array, without_parts: Float32Array) -> Float32Array:
    passable: Float32Array = np.where(np.isinf(slowness) & np.isfinite(without_parts), np.float32(CROSSING), slowness)
    return passable


def _touched(points: FloatArray, radius: float, obstacles: Obstacles) -> list[int]:
    """Return the obstacles that a disc at ``points`` (N, 2) in turn comes too close to, in the order of its way."""
    distance = norm(points[:, None, :] - obstacles.centres, axis=2)
    return [int(index) for index in np.argwhere(distance < radius + obstacles.kept)[:, 1]]


def _downhill(potential: Potential, state: FloatArray) -> NDArray[np.intp]:
    """Return the nodes (M, 3) from the one next to ``state`` down to the goal, each the lowest beside the last."""
    shape = np.array(potential.values.shape)
    position = np.clip(np.rint((state[:2] - potential.lower) / potential.spacing), 0, shape[:2] - 1)
    turn = np.rint(state[2] * shape[2] / (2.0 * np.pi)) % shape[2]
    node = whole(np.append(position, turn), 0, int(shape.max()) - 1)
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3)
    way = [node]
    while True:
        beside = way[-1] + steps
        beside = beside[((beside[:, :2] >= 0) & (beside[:, :2] < shape[:2])).all(axis=1)]
        beside[:, 2] %= shape[2]
        values = potential.values[tuple(beside.T)]
        lowest = int(np.argmin(values))
        if not values[lowest] < potential.values[tuple(way[-1])]:
            return np.array(way)
        way.append(beside[lowest])


def _carrying_slowness(layout: Layout, held: int, obstacles: Obstacles, cost: Cost) -> tuple[Float32Array, FloatArray]:
    x, y, lower = _grid(obstacles.half_size, CARRYING_SPACING)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    of_part = spare(points, float(layout.radii[held]), obstacles)
    distance = layout.grip_distance(held)
    shape = (x.size, y.size, ANGLES.size)
    offset_x, offset_y = (distance * directions(ANGLES.size)).astype(np.float32).T
    robot_x, robot_y = x.astype(np.float32)[:, None, None] - offset_x, y.astype(np.float32)[None, :, None] - offset_y
    robots = [np.ascontiguousarray(np.broadcast_to(axis, shape)).reshape(-1) for axis in (robot_x, robot_y)]
    of_robot = _spare(robots[0], robots[1], layout.robot_radius, obstacles).reshape(shape)
    return cost.slowness(np.minimum(of_robot, of_part[:, :, None])), lower


def _spare(x: Float32Array, y: Float32Array, radius: float, obstacles: Obstacles) -> Float32Array:
    found = np.full(x.size, FAR, dtype=np.float32)
    centres = np.ascontiguousarray(obstacles.centres.T, dtype=np.float32)
    half_x, half_y = obstacles.half_size.tolist()
    kept = obstacles.kept.astype(np.float32)
    kernels.fields.spare_clearances(x, y, float(radius), centres[0], centres[1], kept, half_x, half_y, found)
    return found


def _grid(half_size: FloatArray, spacing: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the nodes' x and y, about the origin and up to the walls, and the lower corner, (2,)."""
    counts = whole(np.ceil(half_size / spacing), 1, 2**31)
    lower = -counts.astype(np.float64) * spacing
    x, y = (bound + spacing * np.arange(2 * count + 1) for bound, count in zip(lower, counts, strict=True))
    return x, y, lower


def _axes(lower: FloatArray, spacing: float, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    return lower[0] + spacing * np.arange(shape[0]), lower[1] + spacing * np.arange(shape[1])


def _solved(
    slowness: Float32Array, at_goal: Float32Array, lower: FloatArray, spacing: float, goal: FloatArray, *, arm: float
) -> Potential:
    """March from the goal at the directions whose slowness there, ``at_goal`` (T,), is finite."""
    x, y = _axes(lower, spacing, slowness.shape)
    distance = np.sqrt(np.square(x[:, None] - goal[0]) + np.square(y - goal[1]))
    at_goal = np.broadcast_to(at_goal, slowness.shape[2:])
    values = np.full(slowness.shape, np.inf, dtype=np.float32)
    start = np.sqrt(distance * distance + TIP * TIP).astype(np.float32)[:, :, None] * at_goal
    for reach in (SEEDED * spacing, FRINGE):  # a goal that is itself hemmed in starts from the nearest open nodes
        seeds = (distance <= reach)[:, :, None] & np.isfinite(slowness) & np.isfinite(at_goal)
        if seeds.any():
            break
    values[seeds] = start[seeds]
    turn = arm * 2.0 * np.pi / slowness.shape[2]
    steps = np.array([spacing, spacing, turn], dtype=np.float32)
    layers = round(FRINGE / spacing)
    depths = kernels.fields.march(values, slowness, steps, layers, BEYOND)
    # A goal may be nearer to a wall than a node is: in its cell V is the distance, and the filter keeps off the wall.
    beside = (distance <= np.sqrt(2.0) * spacing)[:, :, None] & (depths > 0) & np.isfinite(at_goal)
    values[beside] = start[beside]
    return Potential(values, slowness, depths, lower, spacing, goal)
