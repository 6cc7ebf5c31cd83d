"""Measures of a rearrangement run, from arrays of the true and the estimated positions (PARTS eq. 4.3-4.7).

Arrays over time have one row a tick: robot (T, 2), parts (T, p, 2). Lengths are in metres.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "all_home",
    "normalized_part_length",
    "normalized_robot_length",
    "part_position_error",
    "positional_inaccuracy",
    "robot_position_error",
]

FloatArray = NDArray[np.float64]


def all_home(final: FloatArray, goals: FloatArray, tolerance: float) -> bool:
    """Return whether each final position, (p, 2), lies within ``tolerance`` of its goal, (p, 2)."""
    return bool(np.all(np.linalg.norm(final - goals, axis=-1) <= tolerance))


def normalized_part_length(parts: FloatArray, goals: FloatArray) -> float:
    """Return npl: a part's path length over its straight way from start to goal, mean over parts (eq. 4.3).

    A part that starts at its goal has no straight way and is left out; 1 when that is so of every part, the
    value of a perfect run.
    """
    straight = np.linalg.norm(parts[0] - goals, axis=1)
    travelled = np.linalg.norm(np.diff(parts, axis=0), axis=2).sum(axis=0)
    away = straight > 0.0
    return float(np.mean(travelled[away] / straight[away])) if away.any() else 1.0


def normalized_robot_length(
    robot: FloatArray, parts: FloatArray, goals: FloatArray, radii: FloatArray, robot_radius: float
) -> float:
    """Return nrl: the robot's path length over its gaps to all parts at first plus the ways between goals.

    The sum over (i, j) of eq. 4.4 takes each pair of goals once.
    """
    gaps = np.linalg.norm(robot[0] - parts[0], axis=1) - (radii + robot_radius)
    first, second = np.triu_indices(len(goals), 1)
    between = np.linalg.norm(goals[first] - goals[second], axis=1)
    travelled = np.linalg.norm(np.diff(robot, axis=0), axis=1).sum()
    return float(travelled / (gaps.sum() + between.sum()))


def positional_inaccuracy(final: FloatArray, goals: FloatArray, radii: FloatArray) -> float:
    """Return pi: the distance of the final positions, (p, 2), from the goals in radii, mean over parts (eq. 4.5)."""
    return float(np.mean(np.linalg.norm(final - goals, axis=1) / radii))


def robot_position_error(robot: FloatArray, estimated: FloatArray) -> float:
    """Return rpee: the distance between the robot and its estimate, mean over time (eq. 4.6)."""
    return float(np.mean(np.linalg.norm(robot - estimated, axis=1)))


def part_position_error(parts: FloatArray, estimated: FloatArray) -> float:
    """Return ppee: the norm of the error of all parts' positions stacked, mean over time (eq. 4.7)."""
    return float(np.mean(np.linalg.norm((parts - estimated).reshape(len(parts), -1), axis=1)))
