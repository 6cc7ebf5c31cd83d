"""From a potential's gradient to one tick's step: the direction of descent at a speed of our choosing.

The size of a gradient says how a potential is scaled, not how fast a robot should go; only its direction is
used. The speed is constant far from the goal and falls in proportion to the distance close to it.
"""

import numpy as np

from dynpf.portable import norm, sincos
from dynpf.types import FloatArray

__all__ = ["descent_step", "limit_step", "step_length", "swing_basis"]


def step_length(distance_to_go: float, longest: float, slow_distance: float) -> float:
    """Return the length of the next step: ``longest``, less in proportion within ``slow_distance``."""
    return longest * min(1.0, max(distance_to_go, 0.0) / slow_distance)


def descent_step(gradient: FloatArray, length: float) -> FloatArray:
    """Return the step of ``length`` against ``gradient``, (d,); the zero step where the gradient vanishes."""
    steepness = norm(gradient)
    return -gradient * (length / steepness) if steepness > 0.0 else np.zeros_like(gradient)


def limit_step(step: FloatArray, longest: float) -> FloatArray:
    """Return ``step``, shortened to the length ``longest`` when it is longer."""
    length = norm(step)
    return step if length <= longest else step * (longest / length)


def swing_basis(theta: float, distance: float, arm: float) -> FloatArray:
    """Return J, (3, 3), that takes (db_x, db_y, arm dtheta) to (dx, dy, dtheta) of a robot holding a part.

    Steepest descent depends on the metric. In these coordinates it is that of the part and the swing about
    it, ||db||^2 + (arm dtheta)^2: the goal pulls the part straight, and only obstacles swing the robot about
    it. The part's centre is at ``distance`` from the robot's, in the direction ``theta``.
    """
    lever = distance / arm
    sine, cosine = sincos(theta)
    return np.array([[1.0, 0.0, lever * sine], [0.0, 1.0, -lever * cosine], [0.0, 0.0, 1.0 / arm]])
