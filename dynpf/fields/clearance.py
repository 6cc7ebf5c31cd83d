"""Clearances between discs and walls, and the local filter that keeps a step from using them up.

A clearance is the gap between two outlines: negative when they overlap. Each one bounds the next step
linearly; the filter returns the step nearest to the wanted one that meets every bound. Metres and radians.
"""

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.fields.layout import Layout
from dynpf.portable import norm, product, sincos
from dynpf.portable.functions import as_values
from dynpf.types import FloatArray

__all__ = [
    "allowed_steps",
    "carrying_bounds",
    "disc_clearances",
    "project_step",
    "robot_bounds",
    "wall_clearances",
]


TOLERANCE = 1e-10  # metres


def disc_clearances(centre: FloatArray, radius: float, others: FloatArray, radii: FloatArray) -> FloatArray:
    """Return the clearance of one disc from each of ``others``, (n, 2) with ``radii``, (n,): shape (n,)."""
    clearances: FloatArray = norm(centre - others, axis=1) - (radius + radii)
    return clearances


def wall_clearances(centre: FloatArray, radius: float, half_size: FloatArray) -> FloatArray:
    """Return a disc's clearance from the walls at +x, +y, -x, -y of a workspace about the origin, shape (4,)."""
    return np.concatenate([half_size - centre, half_size + centre]) - radius


def robot_bounds(robot: FloatArray, parts: FloatArray, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Return (rows, clearances): a step u, (2,), leaves at least clearance + row @ u of each clearance.

    Parts come first, in order, then the four walls. The bound is safe, not only of first order: the
    distance to a point is convex in the step.
    """
    return _disc_bounds(robot, layout.robot_radius, parts, layout.radii, layout.half_size)


def carrying_bounds(
    pose: FloatArray, parts: FloatArray, held: int, layout: Layout, max_turn: float
) -> tuple[FloatArray, FloatArray]:
    """Return (rows, clearances) as ``robot_bounds`` does, for a step in (x, y, theta) with a part in the gripper.

    The robot's bounds come first (the other parts, the walls), then those of the part that is held. They are
    safe for turns of at most ``max_turn``: the held part's leave out what the curvature of its arc may take.
    """
    others = layout.others(held)
    part, distance = layout.held_position(pose, held), layout.grip_distance(held)
    obstacles = parts[others], layout.radii[others], layout.half_size
    robot_rows, robot_clearances = _disc_bounds(pose[:2], layout.robot_radius, *obstacles)
    part_rows, part_clearances = _disc_bounds(part, float(layout.radii[held]), *obstacles)
    sine, cosine = sincos(float(pose[2]))
    rows = np.concatenate(
        [
            np.column_stack([robot_rows, np.zeros(len(robot_rows))]),
            np.column_stack([part_rows, distance * (cosine * part_rows[:, 1] - sine * part_rows[:, 0])]),
        ]
    )
    sagitta = 0.5 * distance * max_turn * max_turn
    return rows, np.concatenate([robot_clearances, part_clearances - sagitta])


def project_step(
    step: FloatArray, rows: FloatArray, clearances: FloatArray, margins: FloatArray, rate: float
) -> FloatArray:
    """Return the step nearest to ``step`` for which no clearance c shrinks by more than rate (c - margin).

    Where c is below its margin the step must win back what is missing. When not all of that can be met together, it is
    only asked that no clearance below its margin shrinks any further, which standing still always meets. ``step`` has
    shape (d,), ``rows`` (n, d), ``clearances`` and ``margins`` (n,); ``rate`` lies in (0, 1].
    """
    required = _required(clearances, margins, rate)
    given, projected = as_values(step), np.empty(step.shape)
    rows = as_values(rows)
    for bounds in (required, np.minimum(required, 0.0)):
        if kernels.clearance.project(given, rows, bounds, TOLERANCE, projected):
            return projected
    return np.zeros_like(projected)


def allowed_steps(
    steps: FloatArray, rows: FloatArray, clearances: FloatArray, margins: FloatArray, rate: float
) -> NDArray[np.bool_]:
    """Return which of the steps (k, d) use up no more of any clearance than ``project_step`` allows, shape (k,)."""
    required = np.minimum(_required(clearances, margins, rate), 0.0)
    changes: FloatArray = product(steps, rows.T)
    allowed: NDArray[np.bool_] = np.all(changes >= required - TOLERANCE, axis=1)
    return allowed


def _required(clearances: FloatArray, margins: FloatArray, rate: float) -> FloatArray:
    spare = clearances - margins
    required: FloatArray = np.where(spare > 0.0, -rate * spare, -spare)
    return required


def _disc_bounds(
    centre: FloatArray, radius: float, others: FloatArray, radii: FloatArray, half_size: FloatArray
) -> tuple[FloatArray, FloatArray]:
    rows, clearances = np.empty((len(others) + 4, 2)), np.empty(len(others) + 4)
    given = (as_values(array) for array in (others, radii, half_size))
    kernels.clearance.disc_bounds(as_values(centre), float(radius), *given, rows, clearances)
    return rows, clearances
