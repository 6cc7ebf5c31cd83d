"""Linear motion with Gaussian noise, of states of any dimension: the model that a Kalman filter solves exactly."""

import msgspec
import numpy as np

from dynpf.covariance import semidefinite_root
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats

__all__ = ["LinearGaussian", "LinearGaussianParams"]

Matrix = tuple[tuple[float, ...], ...]


class LinearGaussianParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="linear_gaussian"
):
    """Matrices of x' = F x + B u + N(0, Q), row by row; a tuple of no rows for no B."""

    transition: Matrix  # F, (D, D)
    noise: Matrix  # Q, (D, D): symmetric, positive semidefinite, in squares of the state's units
    input: Matrix = ()  # B, (D, M)


class LinearGaussian:
    """x' = F x + B u + w, w drawn from N(0, Q); Q may be singular. Works in the precision of the states.

    The control u is an array (M,), or None for none. Raises ValueError for matrices whose shapes do not fit, that
    hold what is not finite, and for a Q that is no covariance.
    """

    def __init__(self, params: LinearGaussianParams) -> None:
        self.params = validated(params)
        self._f = _matrix("transition", params.transition, len(params.transition), len(params.transition))
        dimension = len(self._f)
        self._q = _matrix("noise", params.noise, dimension, dimension)
        columns = len(params.input[0]) if params.input else 0
        self._b = _matrix("input", params.input or ((),) * dimension, dimension, columns)
        try:
            self._root = semidefinite_root(self._q)
        except ValueError as error:
            raise ValueError(f"noise = {params.noise}: {error}") from None

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        """Return the states (D, N) as they are."""
        return poses

    def propagate(self, particles: Floats, control: Floats | None, stream: Stream) -> Floats:
        """Return draws from N(F x + B u, Q), shape (D, N)."""
        return self.expected(particles, control) + _times(self._root, stream.normals(*particles.shape), particles.dtype)

    def expected(self, states: Floats, control: Floats | None) -> Floats:
        """Return F x + B u, shape (D, N). Raises ValueError where the control is not of shape (M,)."""
        moved = _times(self._f, states, states.dtype)
        if control is not None:
            given = np.asarray(control, dtype=np.float64)
            if given.shape != self._b.shape[1:]:
                raise ValueError(f"control of shape {given.shape}: the input matrix takes {self._b.shape[1:]}")
            moved += (self._b * given).sum(axis=1)[:, None].astype(states.dtype)
        return moved

    def jacobian(self, states: Floats, control: Floats | None) -> Floats:  # noqa: ARG002
        """Return F for each column, shape (D, D, N)."""
        return _everywhere(self._f, states)

    def covariance(self, states: Floats, control: Floats | None) -> Floats:  # noqa: ARG002
        """Return Q for each column, shape (D, D, N)."""
        return _everywhere(self._q, states)


def _matrix(name: str, rows: Matrix, height: int, width: int) -> FloatArray:
    if height == 0 or len(rows) != height or any(len(row) != width for row in rows):
        raise ValueError(f"{name} = {rows}: expected {height or 'some'} rows of {width or 'some'} numbers")
    matrix = np.array(rows, dtype=np.float64)
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} = {rows}: expected finite numbers")
    if name == "noise" and not np.array_equal(matrix, matrix.T):
        raise ValueError(f"{name} = {rows}: expected a symmetric matrix")
    return matrix


def _times(matrix: FloatArray, columns: Floats, dtype: np.dtype[np.floating]) -> Floats:
    """Return matrix (D, D) times columns (D, N), summed in the order of the rows: for every column the same bits."""
    factors, columns = matrix.astype(dtype), columns.astype(dtype, copy=False)
    total: Floats = factors[:, :1] * columns[0]
    for k in range(1, len(columns)):
        total += factors[:, k : k + 1] * columns[k]
    return total


def _everywhere(matrix: FloatArray, states: Floats) -> Floats:
    return np.repeat(matrix.astype(states.dtype)[:, :, None], states.shape[1], axis=2)
