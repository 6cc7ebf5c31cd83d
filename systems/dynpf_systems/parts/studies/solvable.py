"""Whether a layout can be solved at all, by a search that has nothing in common with the controller.

Parts are taken to their goals one after another. A part can be taken when robot and part together have a connected
path through the free cells of a grid over (x, y, theta), and the robot one to where it grips; the order is searched. A
layout that needs a part to be put aside first, or a narrower passage than the grid sees, does not count as solvable.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.fields.layout import Layout
from dynpf.types import FloatArray

__all__ = ["CLEARANCE", "order_of"]

CELL = 0.02  # m
ANGLES = 24  # of the gripper
TRIES = 1  # moves that are tried, times p^2, before a layout counts as not solvable
CLEARANCE = 0.015  # m, that robot and part keep from everything else

Mask = NDArray[np.bool_]
Point = tuple[float, float]


class _Grid(NamedTuple):
    """Cell centres along x and y."""

    x: FloatArray
    y: FloatArray

    @classmethod
    def over(cls, half_size: FloatArray) -> "_Grid":
        """Return the grid over a workspace about the origin."""
        counts = [math.floor(side / CELL) for side in half_size.tolist()]
        x, y = (CELL * np.arange(-count, count + 1) for count in counts)
        return cls(x, y)

    def cell(self, point: FloatArray) -> tuple[int, int]:
        """Return the cell nearest to a point."""
        return int(np.argmin(np.abs(self.x - point[0]))), int(np.argmin(np.abs(self.y - point[1])))

    def free(self, radius: float, discs: FloatArray, radii: FloatArray, half_size: FloatArray, shift: Point) -> Mask:
        """Return where a disc fits whose centre is the cell's plus ``shift``, (nx, ny)."""
        x, y = self.x + shift[0], self.y + shift[1]
        inside: Mask = np.abs(x)[:, None] <= half_size[0] - radius - CLEARANCE
        inside = inside & (np.abs(y)[None, :] <= half_size[1] - radius - CLEARANCE)
        for (disc_x, disc_y), disc_radius in zip(discs.tolist(), radii.tolist(), strict=True):
            squared = (x - disc_x)[:, None] ** 2 + (y - disc_y)[None, :] ** 2
            inside &= squared >= (radius + disc_radius + CLEARANCE) ** 2
        return inside


def order_of(layout: Layout, robot: FloatArray, starts: FloatArray) -> list[int] | None:
    """Return an order in which all parts can be taken home, None where none was found.

    ``robot`` (2,) and ``starts`` (p, 2) are where the robot and the parts begin.
    """
    grid = _Grid.over(layout.half_size)
    dead: set[frozenset[int]] = set()
    left = TRIES * len(starts) * len(starts)

    def search(robot: FloatArray, parts: FloatArray, placed: tuple[int, ...]) -> list[int] | None:
        """Return the order from here on; depth first."""
        nonlocal left
        if len(placed) == len(starts):
            return list(placed)
        if frozenset(placed) in dead:
            return None
        for part in range(len(starts)):
            if part in placed or left == 0:
                continue
            left -= 1
            if (after := _taken(grid, layout, robot, parts, part)) is not None:
                moved = parts.copy()
                moved[part] = layout.goals[part]
                if (order := search(after, moved, (*placed, part))) is not None:
                    return order
        dead.add(frozenset(placed))
        return None

    return search(robot, starts, ())


def _taken(grid: _Grid, layout: Layout, robot: FloatArray, parts: FloatArray, part: int) -> FloatArray | None:
    """Return where the robot is once it has taken ``part`` home; None if it cannot."""
    others = layout.others(part)
    obstacles = parts[others], layout.radii[others], layout.half_size
    distance = layout.grip_distance(part)
    alone = grid.free(layout.robot_radius, parts, layout.radii - CLEARANCE, layout.half_size, (0.0, 0.0))
    _, reached = cv2.connectedComponents(alone.astype(np.uint8), connectivity=4)
    here = reached[grid.cell(robot)]
    part_free = grid.free(float(layout.radii[part]), *obstacles, (0.0, 0.0))
    start, end = grid.cell(parts[part]), grid.cell(layout.goals[part])
    arms = [
        (-distance * math.cos(angle), -distance * math.sin(angle))
        for angle in (math.tau * np.arange(ANGLES) / ANGLES).tolist()
    ]
    labels = _connected([part_free & grid.free(layout.robot_radius, *obstacles, arm) for arm in arms])
    # The robot grips from where it comes to, a little behind where it holds the part, and leaves in the same way.
    back = 1.0 + (2.0 * CELL) / distance
    behind = [parts[part] + back * np.array(arm) for arm in arms]
    gripped = {int(labels[index][start]) for index, at in enumerate(behind) if here and reached[grid.cell(at)] == here}
    put_down = [index for index in range(ANGLES) if labels[index][end] and int(labels[index][end]) in gripped]
    return layout.goals[part] + back * np.array(arms[put_down[0]]) if put_down else None


def _connected(slices: list[Mask]) -> list[NDArray[np.int64]]:
    """Return labels of the components of free cells over (theta, x, y); zero is not free."""
    found, count = [], 0
    for free in slices:
        number, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
        found.append(np.where(labels > 0, labels + count, 0).astype(np.int64))
        count += number
    root = np.arange(count + 1)

    def find(label: int) -> int:
        """Return the representative of a component."""
        while root[label] != label:
            root[label] = root[root[label]]
            label = int(root[label])
        return label

    for first, second in zip(found, [*found[1:], found[0]], strict=True):
        both = (first > 0) & (second > 0)
        for pair in np.flatnonzero(np.bincount(first[both] * (count + 1) + second[both])).tolist():
            root[find(pair // (count + 1))] = find(pair % (count + 1))
    roots = np.array([find(label) for label in range(count + 1)])
    return [roots[labels] for labels in found]
