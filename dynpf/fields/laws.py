"""The feedback laws of the robot's stages: one tick's step from the present positions, with nothing remembered.

Each law descends its potential at the speed law's pace and passes the step through the clearance filter.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynpf.fields.clearance import carrying_bounds, project_step, robot_bounds
from dynpf.fields.layout import Layout
from dynpf.fields.potentials import mate_part_gradient, move_part_gradient
from dynpf.fields.speed import descent_step, limit_step, step_length, swing_basis
from dynpf.portable import norm, product, sincos
from dynpf.types import FloatArray

__all__ = ["Margins", "Pace", "leave_step", "mate_step", "move_step"]


@dataclass(frozen=True)
class Pace:
    """How far a tick may go; metres, radians."""

    longest: float  # step of the robot, or of the part that it holds
    slow_distance: float  # steps shorten in proportion within this distance of the goal
    max_turn: float  # of the gripper with a part in it
    arm: float  # length that makes a turn comparable with a step, as a fraction of the grip distance
    rate: float  # share of a clearance beyond its margin that one step may use up


@dataclass(frozen=True)
class Margins:
    """Clearances in metres that the filter keeps from each part, (p,), and from the walls."""

    parts: FloatArray
    walls: float

    def of_robot(self, parts: NDArray[np.intp]) -> FloatArray:
        return np.concatenate([self.parts[parts], np.full(4, self.walls)])


def mate_step(
    robot: FloatArray,
    parts: FloatArray,
    target: int,
    layout: Layout,
    *,
    margins: Margins,
    exponent: float,
    pace: Pace,
) -> FloatArray:
    """Return the robot's step, (2,), towards the place where it can grip ``target`` (mate-part)."""
    gradient = mate_part_gradient(robot, parts, target, layout, exponent)
    distance = norm(robot - parts[target]) - layout.grip_distance(target)
    step = descent_step(gradient, step_length(distance, pace.longest, pace.slow_distance))
    return _clear_step(step, robot, parts, layout, margins=margins, pace=pace)


def move_step(
    pose: FloatArray,
    parts: FloatArray,
    held: int,
    layout: Layout,
    *,
    margins: Margins,
    exponent: float,
    pace: Pace,
) -> FloatArray:
    """Return the step in (x, y, theta) of a robot that carries part ``held`` to its goal (move-part)."""
    distance = layout.grip_distance(held)
    arm = pace.arm * distance
    basis = swing_basis(float(pose[2]), distance, arm)
    gradient = move_part_gradient(pose, parts, held, layout, exponent)
    to_go = norm(layout.held_position(pose, held) - layout.goals[held])
    step = descent_step(product(gradient, basis), step_length(to_go, pace.longest, pace.slow_distance))
    rows, clearances = carrying_bounds(pose, parts, held, layout, pace.max_turn)
    kept = margins.of_robot(layout.others(held))
    step = project_step(step, product(rows, basis), clearances, np.concatenate([kept, kept]), pace.rate)
    step = limit_step(step, pace.longest)
    turn = abs(float(step[2])) / arm
    return product(basis, step if turn <= pace.max_turn else step * (pace.max_turn / turn))


def leave_step(pose: FloatArray, parts: FloatArray, layout: Layout, *, margins: Margins, pace: Pace) -> FloatArray:
    """Return the robot's step, (2,), backwards from where its gripper points."""
    sine, cosine = sincos(float(pose[2]))
    backwards = -pace.longest * np.array([cosine, sine])
    return _clear_step(backwards, pose[:2], parts, layout, margins=margins, pace=pace)


def _clear_step(
    step: FloatArray, robot: FloatArray, parts: FloatArray, layout: Layout, *, margins: Margins, pace: Pace
) -> FloatArray:
    rows, clearances = robot_bounds(robot, parts, layout)
    kept = margins.of_robot(np.arange(len(parts)))
    return limit_step(project_step(step, rows, clearances, kept, pace.rate), pace.longest)
