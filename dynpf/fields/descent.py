"""One tick's step down a navigation potential, past the clearance filter.

The step goes against the gradient; where the filter turns it uphill, the lowest of a few other steps is taken. So every
step lowers the potential or is zero, except while a clearance below its margin is won back.
"""

import itertools
from typing import NamedTuple

import numpy as np

from dynpf.fields.clearance import allowed_steps, carrying_bounds, project_step, robot_bounds
from dynpf.fields.laws import Margins, Pace
from dynpf.fields.layout import Layout
from dynpf.fields.navigation import Potential
from dynpf.fields.speed import descent_step, limit_step, step_length, swing_basis
from dynpf.portable import norm, product
from dynpf.types import FloatArray

__all__ = ["approach_step", "carry_step", "dock_step"]


SHARES = (1.0, 0.5, 0.25)  # of the length, of the steps tried in the gradient's place


class _Bounds(NamedTuple):
    """What the clearance filter is given, and the most that a step may turn, as a length; see project_step."""

    rows: FloatArray
    clearances: FloatArray
    margins: FloatArray
    rate: float
    longest: float
    most: float = np.inf

    def nearest(self, step: FloatArray) -> FloatArray:
        """Return the step nearest to ``step`` that the filter allows, made shorter where it is too long."""
        step = project_step(self._limited(step), self.rows, self.clearances, self.margins, self.rate)
        return self._limited(limit_step(step, self.longest))

    def allowed(self, steps: FloatArray) -> FloatArray:
        """Return those of the steps (k, d) that may be taken as they are."""
        steps = steps[(np.abs(steps[:, 2:]) <= self.most).all(axis=1)]
        return steps[allowed_steps(steps, self.rows, self.clearances, self.margins, self.rate)]

    def _limited(self, step: FloatArray) -> FloatArray:
        turn = float(np.abs(step[2:]).max(initial=0.0))
        return step if turn <= self.most else step * (self.most / turn)


def approach_step(
    potential: Potential,
    robot: FloatArray,
    parts: FloatArray,
    layout: Layout,
    *,
    margins: Margins,
    pace: Pace,
    to_go: float,
) -> FloatArray:
    """Return the step, (2,), of a robot on its way down ``potential``; ``to_go`` metres decide on its length."""
    length = step_length(to_go, pace.longest, pace.slow_distance)
    return _descend(potential, np.append(robot, 0.0), length, _bounds(robot, parts, layout, margins, pace), arm=1.0)


def dock_step(
    robot: FloatArray, parts: FloatArray, target: int, layout: Layout, *, margins: Margins, pace: Pace
) -> FloatArray:
    """Return the step, (2,), of a robot that goes straight for ``target`` to grip it."""
    offset = parts[target] - robot
    distance = norm(offset)
    length = step_length(distance - layout.grip_distance(target), pace.longest, pace.slow_distance)
    return _bounds(robot, parts, layout, margins, pace).nearest(descent_step(-offset, length))


def carry_step(
    potential: Potential,
    pose: FloatArray,
    parts: FloatArray,
    held: int,
    layout: Layout,
    *,
    margins: Margins,
    pace: Pace,
) -> FloatArray:
    """Return the step in (x, y, theta) of a robot that carries part ``held`` down ``potential``."""
    distance = layout.grip_distance(held)
    arm = pace.arm * distance
    part = layout.held_position(pose, held)
    basis = swing_basis(float(pose[2]), distance, arm)
    rows, clearances = carrying_bounds(pose, parts, held, layout, pace.max_turn)
    kept = np.tile(margins.of_robot(layout.others(held)), 2)
    length = step_length(norm(part - potential.goal), pace.longest, pace.slow_distance)
    bounds = _Bounds(product(rows, basis), clearances, kept, pace.rate, pace.longest, most=pace.max_turn * arm)
    return product(basis, _descend(potential, np.append(part, pose[2]), length, bounds, arm=arm))


def _bounds(robot: FloatArray, parts: FloatArray, layout: Layout, margins: Margins, pace: Pace) -> _Bounds:
    rows, clearances = robot_bounds(robot, parts, layout)
    return _Bounds(rows, clearances, margins.of_robot(np.arange(len(parts))), pace.rate, pace.longest)


def _descend(potential: Potential, state: FloatArray, length: float, bounds: _Bounds, *, arm: float) -> FloatArray:
    """Return the step in (x, y) or (x, y, arm theta), (d,), of at most ``length`` where it is free to be so."""
    size = bounds.rows.shape[1]
    step = bounds.nearest(descent_step(potential.gradient(state, arm)[:size], length))
    here, there = _values(potential, state, np.stack([np.zeros(size), step]), arm)
    if there < here or (bounds.clearances < bounds.margins).any():
        return step
    tried = np.array([direction for direction in itertools.product((-1.0, 0.0, 1.0), repeat=size) if any(direction)])
    tried /= norm(tried, axis=1)[:, None]
    tried = bounds.allowed(np.concatenate([share * length * tried for share in SHARES]))
    values = _values(potential, state, tried, arm)
    lower = values.size and values.min() < here
    return np.asarray(tried[np.argmin(values)]) if lower else np.zeros(size)


def _values(potential: Potential, state: FloatArray, steps: FloatArray, arm: float) -> FloatArray:
    scales = np.array([1.0, 1.0, arm])[: steps.shape[1]]
    moved = np.tile(state, (len(steps), 1))
    moved[:, : steps.shape[1]] += steps / scales
    return potential.at(moved)
