"""Poses in the plane: angles on the circle, composition, and the displacement of a circular arc.

A pose is (x, y, theta) in metres and radians, anticlockwise positive. Arrays of poses have the coordinate first,
shape (3, ...), so that each coordinate of many poses is contiguous.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynpf.portable import atan2, cos, sin, sinc, sincos
from dynpf.types import FloatArray, Floats

__all__ = [
    "FAR_M",
    "FloatArray",
    "Floats",
    "arc_chord",
    "arc_displacement",
    "circular_mean",
    "compose",
    "is_far",
    "relative",
    "wrap_angle",
]


FAR_M = 10_000.0
"""From zero: farther out a float32 does not tell positions a millimetre apart."""


def is_far(poses: Floats) -> bool:
    """Return whether any pose (3, N) is so far from zero that float32 is too coarse for it."""
    return bool((np.abs(poses[:2]) >= FAR_M).any())


def wrap_angle(angle: ArrayLike) -> Any:
    """Return ``angle`` in [-pi, pi], of the same shape; an angle that is there already comes back unchanged."""
    values = np.asarray(angle, dtype=np.float64)
    return values - 2.0 * np.pi * np.rint(values / (2.0 * np.pi))


def compose(pose: FloatArray, relative: FloatArray) -> FloatArray:
    """Return ``relative``, given in the frame of ``pose``, in the frame of ``pose`` itself; shapes (3, ...)."""
    sine, cosine = sincos(pose[2])
    return np.array(
        (
            pose[0] + cosine * relative[0] - sine * relative[1],
            pose[1] + sine * relative[0] + cosine * relative[1],
            wrap_angle(pose[2] + relative[2]),
        )
    )


def relative(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Return ``other``, given in the frame in which ``pose`` is, in the frame of ``pose``: compose undone; (3, ...)."""
    sine, cosine = sincos(pose[2])
    dx, dy = other[0] - pose[0], other[1] - pose[1]
    return np.array((cosine * dx + sine * dy, cosine * dy - sine * dx, wrap_angle(other[2] - pose[2])))


def circular_mean(angles: Floats, weights: Floats) -> float:
    """Return the direction of the weighted mean of unit vectors, radians; both of shape (N,).

    Where the vectors cancel there is no mean direction; rounding then decides what comes back.
    """
    sine, cosine = sincos(angles)
    return atan2(float(np.sum(weights * sine)), float(np.sum(weights * cosine)))


def arc_chord(length: ArrayLike, turn: ArrayLike) -> Any:
    """Return the chord, in metres, of an arc of ``length`` metres that turns by ``turn`` radians.

    The arc about the instantaneous centre of rotation (LANDMARK section 1) ends length sin(turn/2) / (turn/2)
    away, in the direction turn/2 from its start's heading: exact for every turn, the straight line included.
    """
    half = 0.5 * np.asarray(turn, dtype=np.float64)
    return np.asarray(length, dtype=np.float64) * sinc(half / np.pi)


def arc_displacement(length: ArrayLike, turn: ArrayLike) -> FloatArray:
    """Return the end pose (dx, dy, turn), shape (3, ...), of an arc in the frame of its start."""
    if isinstance(length, float) and isinstance(turn, float):
        return _displacement_of_one(length, turn)
    chord = arc_chord(length, turn)
    half = 0.5 * np.asarray(turn, dtype=np.float64)
    displacement = np.empty((3, *np.broadcast_shapes(np.shape(chord), np.shape(half))))
    displacement[0], displacement[1], displacement[2] = chord * cos(half), chord * sin(half), 2.0 * half
    return displacement


def _displacement_of_one(length: float, turn: float) -> FloatArray:
    half = 0.5 * turn
    chord = length * sinc(half / np.pi)
    sine, cosine = sincos(half)
    return np.array((chord * cosine, chord * sine, 2.0 * half))
