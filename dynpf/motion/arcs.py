"""Exact circular arcs about the instantaneous centre of rotation, with noise that grows with the way made."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.motion.model import Twist
from dynpf.se2 import FloatArray, arc_chord

__all__ = ["Arcs", "ArcsParams", "follow_arc", "follow_noisy_arc"]

Variance = Annotated[float, Meta(ge=0.0)]


class ArcsParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="arcs"):
    """Noise variances per metre of way and per radian turned, so that the step's length does not matter."""

    along_variance_per_m: Variance = 0.1  # m^2 per m, in the direction of motion
    across_variance_per_m: Variance = 0.0015  # m^2 per m, sideways slip
    turn_variance_per_rad: Variance = 0.078  # rad^2 per rad turned
    turn_variance_per_m: Variance = 0.003  # rad^2 per m driven


class Arcs:
    """Motion along the arc of a constant twist (LANDMARK section 1), its length, turn and slip perturbed."""

    def __init__(self, params: ArcsParams) -> None:
        self.params = params

    def particles(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:  # noqa: ARG002
        """Return the poses: this model estimates nothing else."""
        return poses

    def propagate(self, particles: FloatArray, twist: Twist, duration: float, rng: np.random.Generator) -> FloatArray:
        """Return particles (D, N) moved; rows after the third pass through. A robot at rest gets no noise."""
        return follow_noisy_arc(particles, twist, duration, self.params, rng)


def follow_noisy_arc(
    particles: FloatArray,
    twist: Twist,
    duration: float,
    params: ArcsParams,
    rng: np.random.Generator,
    *,
    turn_scale: float | FloatArray = 1.0,
) -> FloatArray:
    """Return particles (D, N) after ``duration`` seconds of ``twist`` with noise, its turn times ``turn_scale``.

    The noise goes by the twist as given, the same for all particles: were it scaled too, particles of a small
    scale would spread less, keep more weight for that alone, and draw the estimate of the scale down.
    """
    length, turn = twist.v * duration, twist.w * duration
    way, turned = abs(length), abs(turn)
    noise = rng.standard_normal((3, particles.shape[1]))
    turn_variance = params.turn_variance_per_rad * turned + params.turn_variance_per_m * way
    return follow_arc(
        particles,
        length + np.sqrt(params.along_variance_per_m * way) * noise[0],
        turn * turn_scale + np.sqrt(turn_variance) * noise[1],
        np.sqrt(params.across_variance_per_m * way) * noise[2],
    )


def follow_arc(
    particles: FloatArray,
    length: float | FloatArray,
    turn: float | FloatArray,
    slip: float | FloatArray = 0.0,
) -> FloatArray:
    """Return particles (D, N) after arcs of ``length`` metres and ``turn`` radians that slip sideways.

    The slip in metres, positive to the left, is at right angles to the chord. Headings are not wrapped.
    """
    chord = arc_chord(length, turn)
    direction = particles[2] + 0.5 * np.asarray(turn)
    cosine, sine = np.cos(direction), np.sin(direction)
    moved = particles.copy()
    moved[0] += chord * cosine - slip * sine
    moved[1] += chord * sine + slip * cosine
    moved[2] += turn
    return moved
