"""Linear algebra of small matrices, meant for up to some fifteen rows: products, solutions, eigenvalues.

Where a matrix (M, N) is expected, a stack of them (..., M, N) is taken too, and stacks broadcast. Errors are those of
elimination and rotations with rounding to float64, as LAPACK's are; only the order of operations is fixed.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynpf import kernels
from dynpf.portable.functions import as_values, log
from dynpf.types import FloatArray

__all__ = [
    "SingularMatrixError",
    "eigh",
    "inverse",
    "log_determinant",
    "norm",
    "product",
    "singular_values",
    "solve",
]


class SingularMatrixError(ValueError):
    """A matrix has no inverse."""


def norm(vectors: ArrayLike, axis: int | None = None) -> Any:
    """Return the Euclidean length of a vector, or of all vectors along an axis."""
    values = np.asarray(vectors, dtype=np.float64)
    length = np.sqrt((values * values).sum(axis=axis))
    return float(length) if axis is None else length


def product(*factors: ArrayLike) -> FloatArray:
    """Return the product of matrices, from the left; a vector (N,) at an end stands for a row or a column.

    Raises ValueError for shapes that do not fit.
    """
    result = np.asarray(factors[0], dtype=np.float64)
    for factor in factors[1:]:
        result = _product(result, np.asarray(factor, dtype=np.float64))
    return result


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    row, column = left.ndim == 1, right.ndim == 1
    first = left[None, :] if row else left
    second = right[:, None] if column else right
    if first.shape[-1] != second.shape[-2]:
        raise ValueError(f"shapes {left.shape} and {right.shape} do not fit in a product")
    if first.ndim == 2 and second.ndim == 2:
        out: FloatArray = kernels.linear.product(as_values(first), as_values(second))
    else:
        stack = np.broadcast_shapes(first.shape[:-2], second.shape[:-2])
        out = np.empty((*stack, first.shape[-2], second.shape[-1]))
        flat = out.reshape(math.prod(stack), *out.shape[-2:])
        kernels.linear.products(_stacked(first, stack), _stacked(second, stack), flat)
    if column:
        out = out[..., 0]
    return out[..., 0, :] if row and not column else (out[..., 0] if row else out)


def solve(matrices: ArrayLike, right: ArrayLike) -> FloatArray:
    """Return X with A X = B for A (..., N, N) and B (..., N, M), or one vector (N,); raises SingularMatrixError."""
    given = np.asarray(right, dtype=np.float64)
    column = given.ndim == 1
    return _solved(np.asarray(matrices, dtype=np.float64), given[:, None] if column else given, column)[0]


def inverse(matrices: ArrayLike) -> FloatArray:
    """Return the inverses of matrices (..., N, N); raises SingularMatrixError."""
    given = np.asarray(matrices, dtype=np.float64)
    return _solved(given, np.eye(given.shape[-1]))[0]


def log_determinant(matrices: ArrayLike) -> Any:
    """Return log |det A| of matrices (..., N, N): a float of one; raises SingularMatrixError."""
    given = np.asarray(matrices, dtype=np.float64)
    pivots = _solved(given, np.zeros((given.shape[-1], 0)))[1]
    logs = np.sum(log(np.abs(pivots)), axis=-1)
    return float(logs) if given.ndim == 2 else logs


def eigh(matrices: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (..., N), ascending, and eigenvectors (..., N, N) in columns, of symmetric matrices.

    Of each eigenvector the first component that is largest in size is positive.
    """
    given = np.asarray(matrices, dtype=np.float64)
    size = given.shape[-1]
    turned = given.reshape(math.prod(given.shape[:-2]), size, size).copy()
    vectors = np.empty_like(turned)
    kernels.linear.eigen(turned, vectors)
    values = turned[:, np.arange(size), np.arange(size)]
    order = np.argsort(values, axis=1, kind="stable")
    values = np.take_along_axis(values, order, axis=1)
    vectors = np.take_along_axis(vectors, order[:, None, :], axis=2)
    largest = np.take_along_axis(vectors, np.argmax(np.abs(vectors), axis=1)[:, None, :], axis=1)
    vectors = np.where(largest < 0.0, -vectors, vectors)
    return values.reshape(given.shape[:-1]), vectors.reshape(given.shape)


def singular_values(matrix: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the singular values (N,) of a matrix (M, N), descending, and right singular vectors (N, N) in columns."""
    turned = np.array(matrix, dtype=np.float64, order="C")
    vectors = np.empty((turned.shape[1], turned.shape[1]))
    kernels.linear.singular(turned, vectors)
    lengths = norm(turned, axis=0)
    order = np.argsort(-lengths, kind="stable")
    return lengths[order], vectors[:, order]


def _solved(matrices: FloatArray, right: FloatArray, column: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return the solutions, and the pivots (..., N) of the elimination."""
    size = matrices.shape[-1]
    if matrices.ndim < 2 or matrices.shape[-2] != size or right.shape[-2] != size:
        raise ValueError(f"shapes {matrices.shape} and {right.shape} do not fit in an equation A X = B")
    stack = _broadcast(matrices, right)
    upper, solution = _stacked(matrices, stack).copy(), _stacked(right, stack).copy()
    singular = kernels.linear.solve(upper, solution)
    if singular >= 0:
        raise SingularMatrixError(f"a matrix has no inverse: {_stacked(matrices, stack)[singular].tolist()}")
    pivots = upper[:, np.arange(size), np.arange(size)].reshape(*stack, size)
    found = solution.reshape(*stack, *right.shape[-2:])
    return (found[..., 0] if column else found), pivots


def _broadcast(first: FloatArray, second: FloatArray) -> tuple[int, ...]:
    if first.ndim == 2 and second.ndim == 2:
        return ()
    return np.broadcast_shapes(first.shape[:-2], second.shape[:-2])


def _stacked(matrices: FloatArray, stack: tuple[int, ...]) -> FloatArray:
    """Return the matrices as a stack (B, M, N), contiguous, of the broadcast shape; writable, as kernels expect."""
    shape = (*stack, *matrices.shape[-2:])
    whole = np.ascontiguousarray(matrices if matrices.shape == shape else np.broadcast_to(matrices, shape))
    whole = whole if whole.flags.writeable else whole.copy()
    return whole.reshape(math.prod(stack), *matrices.shape[-2:])
