"""Measures of a rearrangement run, from arrays of the true and the estimated positions (PARTS chapter 4).

Arrays over time have one row a tick: robot (T, 2), parts (T, p, 2). Lengths are in metres.
"""

import math
from typing import NamedTuple

import numpy as np

from dynpf.metrics.bounds import noiseless_information, posterior_information, rms_bound
from dynpf.types import FloatArray

__all__ = [
    "RobotBound",
    "all_home",
    "bound_ratio",
    "kurtosis",
    "normalized_part_length",
    "normalized_robot_length",
    "packing_density",
    "part_position_error",
    "positional_inaccuracy",
    "robot_bound",
    "robot_position_error",
    "signal_to_noise_db",
]


class RobotBound(NamedTuple):
    """The least root mean square error of the robot's position at each tick, (T,), in metres."""

    noisy: FloatArray  # by PARTS eq. 3.35, for a robot whose motion has noise
    noiseless: FloatArray  # by PARTS eq. 3.38, for one that moves just as commanded


def packing_density(goals: FloatArray, radii: FloatArray) -> float:
    """Return comp: 100 C(p, 2) / ln prod (||g_i - g_j||^2 - (rho_i + rho_j)^2), lengths in cm (PARTS chapter 4).

    PARTS prints (rho_i - rho_j)^2, with which discs that overlap would still have a density. Zero for a single part.
    Raises ValueError where goals overlap, or are so close that the product is 1 or less: then it says nothing.
    """
    first, second = np.triu_indices(len(goals), 1)
    if not first.size:
        return 0.0
    squared = np.sum((goals[first] - goals[second]) ** 2, axis=1) - (radii[first] + radii[second]) ** 2
    if np.any(squared <= 0.0):
        raise ValueError("packing density: two goals overlap")
    total = float(np.log(1e4 * squared).sum())
    if total <= 0.0:
        raise ValueError("packing density: the goals are too close for it to be defined")
    return 100.0 * first.size / total


def signal_to_noise_db(speeds: FloatArray, variance: float) -> float:
    """Return 10 log10 of the mean squared speed (T,), m/s, over the measurement's ``variance``, m^2 (eq. 4.1 and 4.2).

    As PARTS has it the ratio has a unit, 1/s^2. Infinite without noise.
    """
    power = float(np.mean(speeds**2))
    if variance == 0.0:
        return math.inf
    return 10.0 * math.log10(power / variance) if power > 0.0 else -math.inf


def kurtosis(particles: FloatArray) -> float:
    """Return E (r - mu)^4 / sigma^4 of particles (D, N) of equal weight, mean over the coordinates (eq. 4.8).

    3 for a Gaussian; N draws from one have 3 (N - 1) / (N + 1) in the mean. NaN where a coordinate does not vary.
    """
    deviation = particles - particles.mean(axis=1, keepdims=True)
    variance = np.mean(deviation**2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.mean(np.mean(deviation**4, axis=1) / variance**2))


def robot_bound(information: FloatArray, process_variance: float) -> RobotBound:
    """Return how well the robot's position can be known, from the readings of each tick.

    ``information`` (T,): of a coordinate, the sum of 1 / R over the sights of a tick, the first of which is all that
    is known at the start (eq. 3.40). ``process_variance``: of a coordinate, a tick. The robot moves as commanded, and
    the filter knows the command: so the motion's Jacobian is the identity, in mate-part and in move-part alike.
    """
    gained = information[1:, None, None, None] * np.eye(2)
    transitions = np.broadcast_to(np.eye(2), gained.shape)
    prior = information[0] * np.eye(2)
    noisy = posterior_information(prior, transitions, process_variance * np.eye(2), gained)
    noiseless = noiseless_information(prior, transitions[:, 0], gained[:, 0])
    return RobotBound(rms_bound(noisy), rms_bound(noiseless))


def bound_ratio(errors: FloatArray, bounds: FloatArray) -> float:
    """Return the root mean square of errors (T,) over that of their bounds (T,); NaN where these are zero."""
    square = float(np.mean(bounds**2))
    return math.sqrt(float(np.mean(errors**2)) / square) if square > 0.0 else math.nan


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
