"""The velocity motion model: a twist whose two velocities, and the final heading, are noisy."""

import math

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.motion.arcs import arc, arc_jacobian, arc_slopes, follow_arc
from dynpf.motion.gaussian import draw, float32_rows, noise_covariance
from dynpf.motion.model import Twist
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import Floats, NonNegative

__all__ = ["Velocity", "VelocityParams"]


class VelocityParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="velocity"
):
    """What each velocity adds, per unit of its absolute value, to the VARIANCES of the three noises."""

    alpha_1: NonNegative = 0.01  # (m/s)^2 per m/s: of the speed, by the speed
    alpha_2: NonNegative = 0.005  # (m/s)^2 per rad/s: of the speed, by the turning rate
    alpha_3: NonNegative = 0.005  # (rad/s)^2 per m/s: of the turning rate, by the speed
    alpha_4: NonNegative = 0.02  # (rad/s)^2 per rad/s: of the turning rate, by the turning rate
    alpha_5: NonNegative = 0.002  # (rad/s)^2 per m/s: of the final rotation's rate, by the speed
    alpha_6: NonNegative = 0.002  # (rad/s)^2 per rad/s: of the final rotation's rate, by the turning rate


class Velocity:
    """sample_motion_model_velocity of INDOOR (Thrun, Burgard and Fox, Probabilistic Robotics, table 5.3).

    The variances are linear in |v| and |w| as INDOOR prints them, where the book's later printings have the squares.
    One error of the velocities lasts a whole step: the same way in more steps spreads less. A robot at rest gets no
    noise. The arc is computed by its chord, exact for w = 0 too. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: VelocityParams) -> None:
        self.params = validated(params)

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        """Return the poses (3, N) in float32: this model estimates nothing else."""
        return float32_rows(poses)

    def propagate(self, particles: Floats, control: Twist, stream: Stream) -> Floats:
        """Return particles (D, N) moved, headings in [-pi, pi]; rows after the third pass through."""
        length, turn = arc(control)
        sigmas = map(math.sqrt, self._variances(control))
        return draw(kernels.motion.follow_twist, particles, stream, length, turn, *sigmas)

    def expected(self, states: Floats, control: Twist) -> Floats:
        """Return the states (D, N) at the end of the arc; headings are not wrapped."""
        return follow_arc(states, *arc(control))

    def jacobian(self, states: Floats, control: Twist) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (D, D, N)."""
        return arc_jacobian(states, *arc(control))

    def covariance(self, states: Floats, control: Twist) -> Floats:
        """Return the noise's covariance to first order, shape (D, D, N)."""
        by_length, by_turn, _ = arc_slopes(states, *arc(control))
        by_final = np.zeros_like(states)
        by_final[2] = 1.0
        return noise_covariance((by_length, by_turn, by_final), self._variances(control))

    def _variances(self, control: Twist) -> tuple[float, float, float]:
        """Return the variances of the arc's length (m^2), of its turn and of the final rotation (rad^2)."""
        p, v, w, squared = self.params, abs(control.v), abs(control.w), control.duration * control.duration
        return (
            (p.alpha_1 * v + p.alpha_2 * w) * squared,
            (p.alpha_3 * v + p.alpha_4 * w) * squared,
            (p.alpha_5 * v + p.alpha_6 * w) * squared,
        )
