"""The three potentials of parts rearrangement, gamma^k / beta each, as logarithms with their gradients.

gamma is a squared distance to go, beta a product over obstacles of the squared centre distance less the
squared contact distance. The logarithm has the same directions of descent and does not overflow. Where PARTS
prints (rho_i - rho_j)^2 in beta, discs that must not touch need (rho_i + rho_j)^2; the mated part is no
obstacle to its robot; and the constant that the other parts add to gamma in eq. 2.5 is left out, because it
flattens the descent to the goal without moving the goal.

With an exponent k larger than the number of factors in beta, the goal attracts from everywhere but a few
saddle points; with a smaller one, obstacles win far from the goal. Metres and radians.
"""

import numpy as np

from dynpf.fields.layout import Layout
from dynpf.portable import log, norm, sincos
from dynpf.types import FloatArray

__all__ = [
    "log_mate_part",
    "log_move_part",
    "mate_part_gradient",
    "move_part_gradient",
    "next_part_gradient",
    "steepest_part",
]


# A factor of beta is held above this fraction of the squared contact distance: an estimate that overlaps an
# obstacle still yields a direction that leads away from it.
CONTACT_FLOOR = 1e-2
# A squared distance to go is held above this, in square metres.
GOAL_FLOOR = 1e-12


def next_part_gradient(parts: FloatArray, layout: Layout, exponent: float) -> FloatArray:
    """Return the gradient of log phi with respect to each part's position, (p, 2) (PARTS eq. 2.1).

    log phi(b) of part positions b (p, 2) is k log ||b - g||^2 less log beta over pairs, k the exponent.
    """
    difference = parts[:, None, :] - parts[None, :, :]
    factors = _factors(difference, layout.radii[:, None] + layout.radii[None, :])
    np.fill_diagonal(factors, np.inf)
    repulsion = (2.0 * difference / factors[:, :, None]).sum(axis=1)
    gradient: FloatArray = _attraction(parts - layout.goals, exponent) - repulsion
    return gradient


def steepest_part(parts: FloatArray, candidates: list[int], layout: Layout, exponent: float) -> int:
    """Return the candidate whose descent on phi is steepest, the first on a tie (next-part, PARTS eq. 2.1).

    Raises ValueError when there is no candidate.
    """
    if not candidates:
        raise ValueError("steepest_part: no candidates; name at least one part")
    steepness = norm(next_part_gradient(parts, layout, exponent), axis=1)
    return max(candidates, key=lambda part: (steepness[part], -part))


def log_mate_part(robot: FloatArray, parts: FloatArray, target: int, layout: Layout, exponent: float) -> float:
    """Return log varphi_i(r, b) of a robot at ``robot``, (2,), on its way to part ``target`` (PARTS eq. 2.2)."""
    others = layout.others(target)
    factors = _factors(robot - parts[others], layout.robot_radius + layout.radii[others])
    return float(exponent * log(_squared(robot - parts[target])) - log(factors).sum())


def mate_part_gradient(
    robot: FloatArray, parts: FloatArray, target: int, layout: Layout, exponent: float
) -> FloatArray:
    """Return the gradient of log varphi_i with respect to the robot's position, (2,) (PARTS eq. 2.3)."""
    others = layout.others(target)
    repulsion = _repulsion(robot - parts[others], layout.robot_radius + layout.radii[others])
    return _attraction(robot - parts[target], exponent) - repulsion


def log_move_part(pose: FloatArray, parts: FloatArray, held: int, layout: Layout, exponent: float) -> float:
    """Return log psi_i(r_a, b) of a robot at (x, y, theta) that holds part ``held`` (PARTS eq. 2.4-2.6)."""
    others = layout.others(held)
    part = layout.held_position(pose, held)
    robot_factors = _factors(pose[:2] - parts[others], layout.robot_radius + layout.radii[others])
    part_factors = _factors(part - parts[others], layout.radii[held] + layout.radii[others])
    obstacles = log(robot_factors).sum() + log(part_factors).sum()
    return float(exponent * log(_squared(part - layout.goals[held])) - obstacles)


def move_part_gradient(pose: FloatArray, parts: FloatArray, held: int, layout: Layout, exponent: float) -> FloatArray:
    """Return the gradient of log psi_i with respect to (x, y, theta), (3,) (PARTS eq. 2.7)."""
    others = layout.others(held)
    part = layout.held_position(pose, held)
    on_robot = -_repulsion(pose[:2] - parts[others], layout.robot_radius + layout.radii[others])
    on_part = _attraction(part - layout.goals[held], exponent)
    on_part = on_part - _repulsion(part - parts[others], layout.radii[held] + layout.radii[others])
    sine, cosine = sincos(float(pose[2]))
    return np.append(on_robot + on_part, layout.grip_distance(held) * (cosine * on_part[1] - sine * on_part[0]))


def _squared(difference: FloatArray) -> float:
    return max(float(np.sum(difference * difference)), GOAL_FLOOR)


def _factors(difference: FloatArray, contact: FloatArray) -> FloatArray:
    squared_contact = contact * contact
    factors: FloatArray = np.maximum(
        (difference * difference).sum(axis=-1) - squared_contact, CONTACT_FLOOR * squared_contact
    )
    return factors


def _attraction(difference: FloatArray, exponent: float) -> FloatArray:
    return 2.0 * exponent * difference / _squared(difference)


def _repulsion(difference: FloatArray, contact: FloatArray) -> FloatArray:
    repulsion: FloatArray = (2.0 * difference / _factors(difference, contact)[:, None]).sum(axis=0)
    return repulsion
