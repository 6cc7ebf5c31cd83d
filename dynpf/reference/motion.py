"""Twins of ``dynpf.kernels.motion``: particles (3, N) or (4, N) and noise of that shape in, what they become out.

A kernel's numbers come in two groups, in the kernel's order: the motion, and the standard deviations of its noise.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray, Floats

__all__ = ["follow_arcs", "follow_own_arcs", "follow_twist", "move_capsule", "rotate_translate_rotate"]

Numbers = Sequence[float]


def follow_arcs(particles: Floats, noise: Floats, motion: Numbers, sigmas: Numbers) -> FloatArray:
    """Return poses after an arc (length, turn) that slips to the left of its chord."""
    length, turn = motion
    return _slipping_arc(particles, noise, length, np.full(particles.shape[1], turn), sigmas)


def follow_own_arcs(particles: Floats, lengths: Floats, turns: Floats, noise: Floats, sigmas: Numbers) -> FloatArray:
    """Return poses after arcs of each particle's own length and turn."""
    return _slipping_arc(particles, noise, lengths, turns, sigmas)


def follow_twist(particles: Floats, noise: Floats, motion: Numbers, sigmas: Numbers) -> FloatArray:
    """Return poses after an arc (length, turn) and a last small rotation (Probabilistic Robotics, table 5.3)."""
    length, turn = np.array(motion)[:, None] + np.array(sigmas[:2])[:, None] * noise[:2]
    x, y = _arc_end(particles, length, turn)
    return np.stack((x, y, wrap_angle(particles[2] + turn + sigmas[2] * noise[2])))


def rotate_translate_rotate(particles: Floats, noise: Floats, motion: Numbers, sigmas: Numbers) -> FloatArray:
    """Return poses after a rotation, a way straight on, and another rotation (table 5.6)."""
    first, way, second = np.array(motion)[:, None] + np.array(sigmas)[:, None] * noise
    x, y, theta = particles
    return np.stack(
        (x + way * np.cos(theta + first), y + way * np.sin(theta + first), wrap_angle(theta + first + second))
    )


def move_capsule(particles: Floats, noise: Floats, motion: Numbers, sigmas: Numbers) -> FloatArray:
    """Return poses after a turn and a way rho along the new heading, each coordinate with noise (COLON)."""
    (rho, turn), (sigma, sigma_theta) = motion, sigmas
    x, y, theta = particles
    return np.stack(
        (
            x + rho * np.cos(theta + turn) + sigma * noise[0],
            y + rho * np.sin(theta + turn) + sigma * noise[1],
            wrap_angle(theta + turn + sigma_theta * noise[2]),
        )
    )


def _slipping_arc(
    particles: Floats, noise: Floats, length: float | Floats, turn: Floats, sigmas: Numbers
) -> FloatArray:
    sigma_along, sigma_turn, sigma_across = sigmas
    turns = turn + sigma_turn * noise[1]
    x, y = _arc_end(particles, length + sigma_along * noise[0], turns)
    slip, left = sigma_across * noise[2], particles[2] + turns / 2.0 + np.pi / 2.0
    return np.stack((x + slip * np.cos(left), y + slip * np.sin(left), wrap_angle(particles[2] + turns)))


def _arc_end(particles: Floats, length: Floats, turn: Floats) -> tuple[Any, Any]:
    """Return where arcs about the instantaneous centre of rotation end (LANDMARK section 1); straight lines for 0."""
    x, y, theta = particles[:3]
    straight = turn == 0.0
    radius = length / np.where(straight, 1.0, turn)
    return (
        np.where(straight, x + length * np.cos(theta), x - radius * np.sin(theta) + radius * np.sin(theta + turn)),
        np.where(straight, y + length * np.sin(theta), y + radius * np.cos(theta) - radius * np.cos(theta + turn)),
    )
