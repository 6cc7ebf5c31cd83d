"""What a filter asks of a motion model."""

from typing import NamedTuple, Protocol

import numpy as np

from dynpf.se2 import FloatArray

__all__ = ["MotionModel", "Twist"]


class Twist(NamedTuple):
    """Forward speed (m/s) and turning rate (rad/s)."""

    v: float
    w: float


class MotionModel(Protocol):
    """Moves particles, columns of a (D, N) array: x, y and theta, then whatever else the model estimates."""

    def particles(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return poses (3, N) as particles (D, N), the further rows drawn from the model's prior."""

    def propagate(self, particles: FloatArray, twist: Twist, duration: float, rng: np.random.Generator) -> FloatArray:
        """Return draws from p(state after ``duration`` seconds | particle, twist), shape (D, N)."""
