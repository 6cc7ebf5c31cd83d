"""Calibration estimated with the pose: further rows of the particles that odometry and bearings are corrected by.

A wheel base that is off, or wheels that slip when turning, scale every commanded turn; a camera mounted askew shifts
every bearing. Both stay almost the same over a run, so a filter that carries them needs far less noise.
"""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.motion.model import MotionModel, Twist
from dynpf.se2 import FloatArray

__all__ = ["BEARING_BIAS", "TURN_SCALE", "CalibratedMotion", "CalibrationParams"]

TURN_SCALE = 3
"""Row of a particle: true turning rate over the odometry's."""

BEARING_BIAS = 4
"""Row of a particle: what the sensor adds to every true bearing, radians."""

NonNegative = Annotated[float, Meta(ge=0.0)]


class CalibrationParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Priors (turn scale around 1, bearing bias around 0) and random walks, as standard deviations."""

    turn_scale_sigma: NonNegative = 0.15
    turn_scale_walk: NonNegative = 0.003  # per square root of a second
    bearing_bias_sigma: NonNegative = 0.02  # rad
    bearing_bias_walk: NonNegative = 0.0002  # rad per square root of a second


class CalibratedMotion:
    """A motion model whose turning rate is scaled, particle by particle, by an estimated factor."""

    def __init__(self, motion: MotionModel, params: CalibrationParams) -> None:
        self.motion = motion
        self.params = params

    def particles(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return poses (3, N) with turn scale and bearing bias drawn from their priors, shape (5, N)."""
        noise = rng.standard_normal((2, poses.shape[1]))
        scale = 1.0 + self.params.turn_scale_sigma * noise[0]
        bias = self.params.bearing_bias_sigma * noise[1]
        return np.vstack((self.motion.particles(poses, rng), scale, bias))

    def propagate(self, particles: FloatArray, twist: Twist, duration: float, rng: np.random.Generator) -> FloatArray:
        """Return particles (5, N) moved by their own scaled twist, their calibration one step further on its walk.

        While the robot rests the calibration rests too: nothing would be seen that could correct it.
        """
        if not (np.any(twist.v) or np.any(twist.w)):
            return particles
        scaled = Twist(twist.v, twist.w * particles[TURN_SCALE])
        moved = self.motion.propagate(particles, scaled, duration, rng)
        noise = np.sqrt(duration) * rng.standard_normal((2, particles.shape[1]))
        moved[TURN_SCALE] += self.params.turn_scale_walk * noise[0]
        moved[BEARING_BIAS] += self.params.bearing_bias_walk * noise[1]
        return moved
