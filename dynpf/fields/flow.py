"""The velocity field of a robot that descends gamma^k / beta among discs, for a filter that knows where it is bound."""

import msgspec
import numpy as np

from dynpf.params import validated
from dynpf.types import Floats, NonNegative, Positive

__all__ = ["DescentFlow", "DescentFlowParams"]


CONTACT_FLOOR = 1e-2  # of the squared contact distance: from an overlap, too, a direction leads away
GOAL_FLOOR = 1e-12  # m^2


class DescentFlowParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the robot is bound, how fast, and the discs in its way."""

    goal: tuple[float, float]  # m
    speed: Positive = 0.2  # m/s
    slow_distance: Positive = 0.06  # m from the goal within which the speed falls with the distance
    exponent: Positive = 8.0  # k of gamma^k / beta; larger than the number of discs, or they win far from the goal
    robot_radius: NonNegative = 0.1  # m
    discs: tuple[tuple[float, float, Positive], ...] = ()  # x, y, radius in m


class DescentFlow:
    """Velocities down the gradient of k log ||r - g||^2 - sum_j log(||r - b_j||^2 - (rho + rho_j)^2) (PARTS eq. 2.2).

    A function of positions (2, N) or of poses (3 and more, N), whose other rows stand still. Raises ValueError for
    parameters out of range.
    """

    def __init__(self, params: DescentFlowParams) -> None:
        self.params = validated(params)

    def __call__(self, states: Floats) -> Floats:
        """Return the velocities (D, N) of states (D, N): m/s in the first two rows, zero in the others."""
        params = self.params
        to_go = states[:2] - np.array(params.goal)[:, None]
        squared = np.maximum((to_go * to_go).sum(axis=0), GOAL_FLOOR)
        gradient = params.exponent * to_go / squared
        for x, y, radius in params.discs:
            away = states[:2] - np.array([[x], [y]])
            contact = (params.robot_radius + radius) * (params.robot_radius + radius)
            gradient -= away / np.maximum((away * away).sum(axis=0) - contact, CONTACT_FLOOR * contact)
        steepness = np.sqrt((gradient * gradient).sum(axis=0))
        speed = params.speed * np.minimum(1.0, np.sqrt(squared) / params.slow_distance)
        velocities = np.zeros_like(states)
        velocities[:2] = -gradient * (speed / np.maximum(steepness, np.finfo(np.float64).tiny))
        return velocities
