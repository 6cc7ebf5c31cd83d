"""Calibration estimated with the pose: a further row of the particles, by which odometry is corrected.

A wheel base that is off, or wheels that slip when turning, scale every turn that odometry reports. The scale hardly
changes over a run, so a filter that carries it learns what it would otherwise have to call noise.
"""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.motion.arcs import ArcsParams, follow_noisy_arc
from dynpf.motion.model import Twist
from dynpf.se2 import FloatArray

__all__ = ["TURN_SCALE", "CalibratedArcs", "CalibrationParams"]

TURN_SCALE = 3
"""Row of a particle: the true turning rate over the odometry's."""

NonNegative = Annotated[float, Meta(ge=0.0)]


class CalibrationParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Standard deviations of the turn scale: of its prior around 1, and of its random walk."""

    turn_scale_sigma: NonNegative = 0.1
    turn_scale_walk: NonNegative = 0.004  # per square root of a second


class CalibratedArcs:
    """Motion along arcs whose turn is scaled, particle by particle, by an estimated factor."""

    def __init__(self, params: ArcsParams, calibration: CalibrationParams) -> None:
        self.params = params
        self.calibration = calibration

    def particles(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return poses (3, N) with turn scales drawn from their prior, shape (4, N)."""
        scale = 1.0 + self.calibration.turn_scale_sigma * rng.standard_normal(poses.shape[1])
        return np.vstack((poses, scale))

    def propagate(self, particles: FloatArray, twist: Twist, duration: float, rng: np.random.Generator) -> FloatArray:
        """Return particles (4, N) moved, each with its own turn scale, and the scales one step further on the walk.

        While the robot rests the scale rests too: nothing would be seen that could correct it.
        """
        if twist.v == 0.0 and twist.w == 0.0:
            return particles
        moved = follow_noisy_arc(particles, twist, duration, self.params, rng, turn_scale=particles[TURN_SCALE])
        step = self.calibration.turn_scale_walk * np.sqrt(duration)
        moved[TURN_SCALE] += step * rng.standard_normal(particles.shape[1])
        return moved
