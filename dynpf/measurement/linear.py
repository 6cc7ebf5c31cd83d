"""A reading that depends linearly on the state, with Gaussian noise: z = H x + v."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels
from dynpf.portable import inverse, log
from dynpf.portable.functions import as_values
from dynpf.types import FloatArray, Floats

__all__ = ["LinearMeasurement", "Observation"]


class Observation(NamedTuple):
    """Numbers read at one instant, shape (M,)."""

    z: Floats


class LinearMeasurement:
    """z = H x + v, v ~ N(0, R): ``matrix`` H of shape (M, D), ``covariance`` R of shape (M, M).

    States are of any dimension and precision, and nothing is an angle. An observation that is not finite tells
    nothing: it is not admitted and its log-likelihood is zero for every particle.
    """

    def __init__(self, matrix: ArrayLike, covariance: ArrayLike) -> None:
        """Raises ValueError where R does not fit H, or is not symmetric and positive definite."""
        self.matrix: FloatArray = np.atleast_2d(np.asarray(matrix, dtype=np.float64))
        self.covariance: FloatArray = np.atleast_2d(np.asarray(covariance, dtype=np.float64))
        rows = len(self.matrix)
        if self.covariance.shape != (rows, rows):
            raise ValueError(f"covariance of shape {self.covariance.shape} for {rows} rows; expected {(rows, rows)}")
        if not np.array_equal(self.covariance, self.covariance.T):
            raise ValueError(f"covariance is not symmetric: {self.covariance.tolist()}")
        root = np.empty(self.covariance.shape)
        definite = kernels.roots.root(as_values(self.covariance), root)
        pivots, variances = np.diag(root), np.diag(self.covariance)
        if not (definite and (pivots * pivots > kernels.roots.ROUNDING * variances).all()):
            raise ValueError(f"covariance is not positive definite: {self.covariance.tolist()}")
        self._whitening = inverse(root)
        self._log_peak = -0.5 * rows * log(2.0 * math.pi) - float(np.sum(log(np.diag(root))))

    def admit(self, particles: Floats, weights: Floats, reading: Observation) -> Observation | None:  # noqa: ARG002
        """Return the observation, None unless every number of it is finite and there is one."""
        return reading if _informs(reading) else None

    def log_likelihood(self, particles: Floats, reading: Observation) -> Floats:
        """Return the log-density of the observation for each particle (D, N), shape (N,), in the particles' precision.

        NaN or -inf for a particle that is not finite. Raises ValueError where D or M is not that of the matrix.
        """
        if not _informs(reading):
            return np.zeros(particles.shape[1], dtype=particles.dtype)
        with np.errstate(over="ignore", invalid="ignore"):
            whitened = _product(self._whitening, self.innovation(particles, reading))
            return np.asarray(self._log_peak - 0.5 * np.sum(whitened * whitened, axis=0), dtype=particles.dtype)

    def innovation(self, states: Floats, reading: Observation) -> Floats:
        """Return z - H x at the states (D, N), shape (M, N)."""
        z = np.asarray(reading.z, dtype=states.dtype)
        if z.shape != self.matrix.shape[:1]:
            raise ValueError(f"an observation of shape {z.shape}; expected {self.matrix.shape[:1]}")
        return z[:, None] - _product(self.matrix, states)

    def jacobian(self, states: Floats, reading: Observation) -> Floats:  # noqa: ARG002
        """Return H for each state, shape (M, D, N), read-only."""
        matrix = self.matrix.astype(states.dtype)[:, :, None]
        return np.broadcast_to(matrix, (*self.matrix.shape, states.shape[1]))

    def noise(self, reading: Observation) -> Floats:  # noqa: ARG002
        """Return R, shape (M, M)."""
        return self.covariance

    def angular(self, reading: Observation) -> NDArray[np.bool_]:  # noqa: ARG002
        """Return that nothing is an angle, shape (M,)."""
        return np.zeros(len(self.matrix), dtype=np.bool_)


def _informs(reading: Observation) -> bool:
    return bool(np.size(reading.z) and np.isfinite(reading.z).all())


def _product(matrix: FloatArray, columns: Floats) -> Floats:
    """Return matrix (M, D) times columns (D, N), added in one order whatever N is, which BLAS does not promise."""
    product = np.zeros((len(matrix), columns.shape[1]), dtype=columns.dtype)
    for factors, row in zip(matrix.astype(columns.dtype).T, columns, strict=True):
        product += factors[:, None] * row
    return product
