"""Exact circular arcs about the instantaneous centre of rotation, with noise that grows with the way made."""

import math
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from dynpf import kernels
from dynpf.motion.gaussian import draw, float32_rows, identities, noise_covariance
from dynpf.motion.model import Twist
from dynpf.params import validated
from dynpf.portable import sincos
from dynpf.rng import Stream
from dynpf.se2 import arc_chord
from dynpf.types import Floats

__all__ = ["ArcNoise", "Arcs", "ArcsParams", "arc_jacobian", "arc_noise", "arc_slopes", "follow_arc"]

Variance = Annotated[float, Meta(ge=0.0)]


class ArcsParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="arcs"):
    """Noise variances per metre of way and per radian turned, so that the step's length does not matter.

    The defaults were chosen on data sets 7 and 9 of UTIAS MRCLAM, small robots with slipping wheels: they are of those
    robots, and no more than a start for another one.
    """

    along_variance_per_m: Variance = 0.1  # m^2 per m, in the direction of motion
    across_variance_per_m: Variance = 0.0015  # m^2 per m, sideways slip
    turn_variance_per_rad: Variance = 0.078  # rad^2 per rad turned
    turn_variance_per_m: Variance = 0.003  # rad^2 per m driven


class ArcNoise(NamedTuple):
    """Variances of an arc's length (m^2), its turn (rad^2) and its slip at right angles to the chord (m^2)."""

    along: float
    turn: float
    across: float


class Arcs:
    """Motion along the arc of a constant twist (LANDMARK section 1), its length, turn and slip perturbed.

    A robot at rest gets no noise. Raises ValueError for parameters out of range.
    """

    def __init__(self, params: ArcsParams) -> None:
        self.params = validated(params)

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        """Return the poses (3, N) in float32: this model estimates nothing else."""
        return float32_rows(poses)

    def propagate(self, particles: Floats, control: Twist, stream: Stream) -> Floats:
        """Return particles (D, N) moved, headings in [-pi, pi]; rows after the third pass through."""
        length, turn = arc(control)
        sigmas = map(math.sqrt, arc_noise(self.params, control))
        return draw(kernels.motion.follow_arcs, particles, stream, length, turn, *sigmas)

    def expected(self, states: Floats, control: Twist) -> Floats:
        """Return the states (D, N) at the end of the arc; headings are not wrapped."""
        return follow_arc(states, *arc(control))

    def jacobian(self, states: Floats, control: Twist) -> Floats:
        """Return the derivative of ``expected`` by the state, shape (D, D, N)."""
        return arc_jacobian(states, *arc(control))

    def covariance(self, states: Floats, control: Twist) -> Floats:
        """Return the noise's covariance to first order, shape (D, D, N)."""
        return noise_covariance(arc_slopes(states, *arc(control)), arc_noise(self.params, control))


def arc(control: Twist) -> tuple[float, float]:
    """Return length (m) and turn (rad) of the arc that a twist describes."""
    return control.v * control.duration, control.w * control.duration


def arc_noise(params: ArcsParams, control: Twist) -> ArcNoise:
    """Return the variances of the arc that a twist describes."""
    way, turned = map(abs, arc(control))
    return ArcNoise(
        along=params.along_variance_per_m * way,
        turn=params.turn_variance_per_rad * turned + params.turn_variance_per_m * way,
        across=params.across_variance_per_m * way,
    )


def follow_arc(states: Floats, length: float | Floats, turn: float | Floats) -> Floats:
    """Return states (D, N) after arcs of ``length`` metres and ``turn`` radians, headings not wrapped."""
    chord, cosine, sine = _chord(states, length, turn)
    moved = states.copy()
    moved[0] += chord * cosine
    moved[1] += chord * sine
    moved[2] += turn
    return moved


def arc_jacobian(states: Floats, length: float | Floats, turn: float | Floats) -> Floats:
    """Return the derivative of the end of the arc by the state it starts from, shape (D, D, N)."""
    chord, cosine, sine = _chord(states, length, turn)
    jacobian = identities(states)
    jacobian[0, 2] = -chord * sine
    jacobian[1, 2] = chord * cosine
    return jacobian


def arc_slopes(states: Floats, length: float | Floats, turn: float | Floats) -> tuple[Floats, Floats, Floats]:
    """Return the derivatives (D, N) of the end of the arc by its length, its turn and its slip to the left."""
    chord, cosine, sine = _chord(states, length, turn)
    chord_by_length = arc_chord(1.0, turn)
    chord_by_turn = 0.5 * np.asarray(length) * _sinc_slope(0.5 * np.asarray(turn))
    by_length, by_turn, by_slip = np.zeros((3, *states.shape), dtype=states.dtype)
    by_length[0], by_length[1] = chord_by_length * cosine, chord_by_length * sine
    by_turn[0] = chord_by_turn * cosine - 0.5 * chord * sine
    by_turn[1] = chord_by_turn * sine + 0.5 * chord * cosine
    by_turn[2] = 1.0
    by_slip[0], by_slip[1] = -sine, cosine
    return by_length, by_turn, by_slip


def _chord(states: Floats, length: float | Floats, turn: float | Floats) -> tuple[Floats, Floats, Floats]:
    direction = states[2] + 0.5 * np.asarray(turn)
    sine, cosine = sincos(direction)
    return arc_chord(length, turn), cosine, sine


def _sinc_slope(angle: Floats) -> Floats:
    """Return the derivative of sin(angle) / angle; by its series where the quotient would cancel."""
    near = np.abs(angle) < 1e-3
    divisor = np.where(near, 1.0, angle)
    sine, cosine = sincos(angle)
    slope: Floats = np.where(near, -angle / 3.0, (cosine - sine / divisor) / divisor)
    return slope
