"""A position measured directly, with Gaussian noise: satellite navigation, an overhead camera (PARTS section 3)."""

import math
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf.params import validated
from dynpf.portable import log
from dynpf.types import Floats, Positive

__all__ = ["GaussianPosition", "GaussianPositionParams", "Position"]

Variance = Annotated[float, Meta(gt=0.0)]


class Position(NamedTuple):
    """Where the robot was seen, metres."""

    x: float
    y: float


class GaussianPositionParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="position"
):
    """Noise: the same in all directions, or a covariance."""

    sigma: Positive = 0.1  # m, of x and of y
    # m^2: variance of x, covariance, variance of y, in place of sigma.
    covariance: tuple[Variance, float, Variance] | None = None


class GaussianPosition:
    """(x, y) plus Gaussian noise, of states (D, N) whose first two rows are x and y.

    A position that is not finite carries no information: it is not admitted and its log-likelihood is zero for every
    particle.
    """

    def __init__(self, params: GaussianPositionParams) -> None:
        """Raises ValueError for a parameter out of its range, or a covariance that is not positive definite."""
        self.params = validated(params)
        self._xx, self._xy, self._yy = params.covariance or (
            params.sigma * params.sigma,
            0.0,
            params.sigma * params.sigma,
        )
        self._determinant = self._xx * self._yy - self._xy * self._xy
        if not self._determinant > 0.0:
            raise ValueError(
                f"GaussianPositionParams.covariance = {params.covariance}: expected a positive definite matrix"
            )

    def admit(self, particles: Floats, weights: Floats, reading: Position) -> Position | None:  # noqa: ARG002
        """Return the reading, None if it is not finite."""
        return reading if np.isfinite(reading).all() else None

    def log_likelihood(self, particles: Floats, reading: Position) -> Floats:
        """Return the log-density of the position for each particle, shape (N,), in the particles' precision.

        NaN or -inf for a particle that is not finite.
        """
        if not np.isfinite(reading).all():
            return np.zeros(particles.shape[1], dtype=particles.dtype)
        x, y = self.innovation(particles, reading)
        with np.errstate(over="ignore", invalid="ignore"):
            squared = (self._yy * (x * x) - 2.0 * self._xy * x * y + self._xx * (y * y)) / self._determinant
        log_peak = -log(2.0 * math.pi) - 0.5 * log(self._determinant)
        return np.asarray(log_peak - 0.5 * squared, dtype=particles.dtype)

    def innovation(self, states: Floats, reading: Position) -> Floats:
        """Return the position read less that of the states, shape (2, N)."""
        return np.array(reading, dtype=states.dtype)[:, None] - states[:2]

    def jacobian(self, states: Floats, reading: Position) -> Floats:  # noqa: ARG002
        """Return the derivatives of x and y by the states (D, N), ones and zeros, shape (2, D, N)."""
        derivatives = np.zeros((2, *states.shape), dtype=states.dtype)
        derivatives[0, 0] = derivatives[1, 1] = 1.0
        return derivatives

    def noise(self, reading: Position) -> Floats:  # noqa: ARG002
        """Return the covariance of the position (m^2), shape (2, 2)."""
        return np.array([[self._xx, self._xy], [self._xy, self._yy]])

    def angular(self, reading: Position) -> NDArray[np.bool_]:  # noqa: ARG002
        """Return that neither coordinate is an angle, shape (2,)."""
        return np.zeros(2, dtype=np.bool_)
