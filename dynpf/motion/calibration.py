"""Calibration estimated with the pose: a further row of the particles, by which odometry is corrected.

A wheel base that is off, or wheels that slip when turning, scale every turn that odometry reports. The scale hardly
changes over a run, so a filter that carries it learns what it would otherwise have to call noise.
"""

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf import kernels
from dynpf.motion.arcs import ArcsParams, arc, arc_jacobian, arc_noise, arc_slopes, follow_arc
from dynpf.motion.gaussian import draw, float32_rows, noise_covariance
from dynpf.motion.model import Twist
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.se2 import Floats

__all__ = ["TURN_SCALE", "CalibratedArcs", "CalibrationParams"]

TURN_SCALE = 3
"""Row of a particle: the true turning rate over the odometry's."""

NonNegative = Annotated[float, Meta(ge=0.0)]


class CalibrationParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Standard deviations of the turn scale: of its prior around 1, and of its random walk."""

    turn_scale_sigma: NonNegative = 0.1
    turn_scale_walk: NonNegative = 0.004  # per square root of a second


class CalibratedArcs:
    """Motion along arcs whose turn is scaled, particle by particle, by an estimated factor.

    The noise goes by the twist as given, the same for all particles: were it scaled too, particles of a small scale
    would spread less, keep more weight for that alone, and draw the estimate of the scale down. While the robot rests
    the scale rests too: nothing would be seen that could correct it. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: ArcsParams, calibration: CalibrationParams) -> None:
        self.params = validated(params)
        self.calibration = validated(calibration)

    def particles(self, poses: Floats, stream: Stream) -> Floats:
        """Return poses (3, N) with turn scales drawn from their prior, shape (4, N), float32."""
        scale = 1.0 + self.calibration.turn_scale_sigma * stream.normals(1, poses.shape[1])
        return np.concatenate((float32_rows(poses), float32_rows(scale)))

    def propagate(self, particles: Floats, control: Twist, stream: Stream) -> Floats:
        """Return particles (4, N) moved, each with its own turn scale, and the scales one step further on the walk."""
        length, turn = arc(control)
        sigmas = map(math.sqrt, (*arc_noise(self.params, control), self._walk_variance(control)))
        return draw(kernels.motion.follow_scaled_arcs, particles, stream, length, turn, *sigmas, rows=4)

    def expected(self, states: Floats, control: Twist) -> Floats:
        """Return the states (4, N) at the end of their arcs; headings are not wrapped."""
        length, turn = arc(control)
        return follow_arc(states, length, turn * states[TURN_SCALE])

    def jacobian(self, states: Floats, control: Twist) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (4, 4, N)."""
        length, turn = arc(control)
        turns = turn * states[TURN_SCALE]
        jacobian = arc_jacobian(states, length, turns)
        _, by_turn, _ = arc_slopes(states, length, turns)
        jacobian[:3, TURN_SCALE] = turn * by_turn[:3]
        return jacobian

    def covariance(self, states: Floats, control: Twist) -> Floats:
        """Return the noise's covariance to first order, shape (4, 4, N)."""
        length, turn = arc(control)
        slopes = arc_slopes(states, length, turn * states[TURN_SCALE])
        covariance = noise_covariance(slopes, arc_noise(self.params, control))
        covariance[TURN_SCALE, TURN_SCALE] = self._walk_variance(control)
        return covariance

    def _walk_variance(self, control: Twist) -> float:
        at_rest = control.v == 0.0 and control.w == 0.0
        return 0.0 if at_rest else self.calibration.turn_scale_walk**2 * control.duration
