"""What the models share: how a kernel is given its rows, and additive noise to first order."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dynpf.rng import Stream
from dynpf.se2 import is_far
from dynpf.types import Floats

__all__ = ["draw", "float32_rows", "identities", "noise_covariance"]

# Columns whose noise is drawn at once: memory of megabytes comes from the system page by page at every call, which
# takes longer than to draw what it holds.
_BATCH = 16384


def float32_rows(particles: Floats) -> Floats:
    """Return particles (D, N) in float32, in which the kernels work; the same array if it is that already.

    Those far from zero stay in float64: see ``draw``.
    """
    if particles.dtype == np.float64 and particles.ndim == 2 and is_far(particles):
        return particles
    return particles.astype(np.float32, copy=False)


def draw(
    kernel: Callable[..., None], particles: Floats, stream: Stream, *numbers: float, own: Sequence[Floats] = ()
) -> Floats:
    """Return particles (D, N) after a kernel of ``dynpf.kernels.motion`` that moves their poses.

    The kernel gets the three rows, ``own``, more rows of float32 (N,) that each particle goes by, a standard normal
    number for each row it moves, then ``numbers``. The other rows pass through. Particles in float64, far from zero,
    are moved about the first of them and stay in float64.
    """
    before = float32_rows(particles)
    if before.dtype == np.float64:
        return _drawn_nearby(kernel, before, stream, *numbers, own=own)
    after = np.empty(before.shape, dtype=np.float32)
    scalars = [float(number) for number in numbers]
    count = before.shape[1]
    for start in range(0, count, _BATCH):
        stop = min(start + _BATCH, count)
        noise = stream.starting_at(start).normals(3, stop - start)
        rows = (row[start:stop] for row in own)
        kernel(*before[:3, start:stop], *rows, noise, *scalars, *after[:3, start:stop])
    after[3:] = before[3:]
    return after


def _drawn_nearby(
    kernel: Callable[..., None], particles: Floats, stream: Stream, *numbers: float, own: Sequence[Floats]
) -> Floats:
    """Return what ``draw`` does of particles far from zero: they are brought close to it, and back."""
    finite = np.isfinite(particles[:2]).all(axis=0)
    anchor = np.rint(particles[:2, int(np.argmax(finite))]) if finite.any() else np.zeros(2)
    near = particles.copy()
    near[:2] -= anchor[:, None]
    moved: Floats = draw(kernel, near.astype(np.float32), stream, *numbers, own=own).astype(np.float64)
    moved[:2] += anchor[:, None]
    return moved


def identities(states: Floats) -> Floats:
    """Return an identity matrix for each column of states (D, N), shape (D, D, N), of the same precision."""
    dimension, count = states.shape
    matrices = np.zeros((dimension, dimension, count), dtype=states.dtype)
    diagonal = np.arange(dimension)
    matrices[diagonal, diagonal] = 1.0
    return matrices


def noise_covariance(directions: Sequence[Floats], variances: Sequence[float]) -> Floats:
    """Return the covariance (D, D, N) of independent noises that move the state along ``directions``, (D, N) each.

    A direction is the derivative of the motion by one noise: the first-order propagation of error.
    """
    covariance: Any = 0.0
    for direction, variance in zip(directions, variances, strict=True):
        covariance = covariance + variance * (direction[:, None] * direction[None, :])
    result: Floats = covariance
    return result
