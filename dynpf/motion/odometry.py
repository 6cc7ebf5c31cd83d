"""The odometry motion model: a displacement as a rotation, a translation and a second rotation, each noisy."""

import math
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.motion.gaussian import draw, float32_rows, identities, noise_covariance
from dynpf.motion.model import Displacement
from dynpf.params import validated
from dynpf.portable import atan2, hypot, sincos
from dynpf.rng import Stream
from dynpf.types import Floats, NonNegative

__all__ = ["OdometryMotion", "OdometryParams", "Steps", "steps"]


SHORTEST_WAY_M = 0.01
"""A translation shorter than this has no direction that odometry could tell."""


class OdometryParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="odometry"
):
    """What movements add to the VARIANCES of the noises: squared as in table 5.6 and nav2, or as they are.

    Variances that grow with the movement itself add up to the same in however many steps it is made; both rotations
    then are as noisy as half of the turn, lest a step sideways be taken for two turns. Units in brackets are those of
    ``growth = "linear"``.
    """

    growth: Literal["squared", "linear"] = "squared"
    alpha_1: NonNegative = 0.05  # rad^2 per rad^2 (rad): of a rotation, by that rotation
    alpha_2: NonNegative = 0.05  # rad^2 per m^2 (m): of a rotation, by the translation
    alpha_3: NonNegative = 0.05  # m^2 per m^2 (m): of the translation, by itself
    alpha_4: NonNegative = 0.05  # m^2 per rad^2 (rad): of the translation, by the two rotations


class Steps(NamedTuple):
    """A displacement taken apart: rotation (rad), way (m, negative when backing up), rotation (rad)."""

    first: float
    way: float
    second: float


class OdometryMotion:
    """sample_motion_model_odometry (Thrun, Burgard and Fox, Probabilistic Robotics, table 5.6), forward and back alike.

    A robot that backs up does not turn round first: its way is negative and its first rotation the smaller one, so
    that neither is noisy for a turn that was not made. (AMCL takes the smaller of |rotation| and |pi - rotation| for
    the noise, which is the same, but for turns of pi on the spot: those it takes for none.) Below a centimetre of way
    the direction is rounding of the odometry; noise then is that of going straight and turning after, while the mean
    is still the displacement. A robot at rest gets no noise. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: OdometryParams) -> None:
        self.params = validated(params)

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        """Return the poses (3, N) in float32: this model estimates nothing else."""
        return float32_rows(poses)

    def propagate(self, particles: Floats, control: Displacement, stream: Stream) -> Floats:
        """Return particles (D, N) moved, headings in [-pi, pi]; rows after the third pass through."""
        made = steps(control)
        sigmas = map(math.sqrt, self._variances(control, made))
        return draw(kernels.motion.rotate_translate_rotate, particles, stream, *made, *sigmas)

    def expected(self, states: Floats, control: Displacement) -> Floats:
        """Return the states (D, N) composed with the displacement; headings are not wrapped."""
        made = steps(control)
        sine, cosine = sincos(states[2] + made.first)
        moved = states.copy()
        moved[0] += made.way * cosine
        moved[1] += made.way * sine
        moved[2] += control.turn
        return moved

    def jacobian(self, states: Floats, control: Displacement) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (D, D, N)."""
        made = steps(control)
        sine, cosine = sincos(states[2] + made.first)
        jacobian = identities(states)
        jacobian[0, 2] = -made.way * sine
        jacobian[1, 2] = made.way * cosine
        return jacobian

    def covariance(self, states: Floats, control: Displacement) -> Floats:
        """Return the noise's covariance to first order, shape (D, D, N)."""
        made = steps(control)
        sine, cosine = sincos(states[2] + made.first)
        by_first, by_way, by_second = np.zeros((3, *states.shape), dtype=states.dtype)
        by_way[0], by_way[1] = cosine, sine
        by_first[0], by_first[1] = -made.way * by_way[1], made.way * by_way[0]
        by_first[2] = by_second[2] = 1.0
        return noise_covariance((by_first, by_way, by_second), self._variances(control, made))

    def _variances(self, control: Displacement, made: Steps) -> Steps:
        p = self.params
        if p.growth == "linear":
            turn, way = abs(0.5 * control.turn), abs(made.way)
            rotation = p.alpha_1 * turn + p.alpha_2 * way
            return Steps(rotation, p.alpha_3 * way + p.alpha_4 * 2.0 * turn, rotation)
        goes = abs(made.way) >= SHORTEST_WAY_M
        first, way, second = (step * step for step in (made if goes else Steps(0.0, made.way, control.turn)))
        return Steps(
            first=p.alpha_1 * first + p.alpha_2 * way,
            way=p.alpha_3 * way + p.alpha_4 * (first + second),
            second=p.alpha_1 * second + p.alpha_2 * way,
        )


def steps(displacement: Displacement) -> Steps:
    """Return the displacement as rotation, translation, rotation; the first at most a quarter turn."""
    ahead = -1.0 if displacement.dx < 0.0 else 1.0
    first = atan2(ahead * displacement.dy, abs(displacement.dx))
    way = ahead * hypot(displacement.dx, displacement.dy)
    return Steps(first, way, math.remainder(displacement.turn - first, 2.0 * math.pi))
