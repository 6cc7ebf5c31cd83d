"""Linear algebra of small matrices in a fixed order of operations; a stack of them at a time, (B, ., .), float64.

BLAS and LAPACK choose their order by the processor, so that the last bits of what they return differ.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["eigen", "eliminate", "multiply", "product", "products", "singular", "solve", "substitute"]

_MOST_SWEEPS = 60
_ROUNDING = 2.0**-52


@device
def multiply(left, right, out):
    """Fill ``out`` (M, N) with the product of ``left`` (M, K) and ``right`` (K, N), summed in order."""
    rows, inner = left.shape
    columns = right.shape[1]
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
        for k in range(inner):
            factor = left[i, k]
            for j in range(columns):
                out[i, j] += factor * right[k, j]


@kernel
def product(left, right):
    """Return the product (M, N) of ``left`` (M, K) and ``right`` (K, N)."""
    out = np.empty((left.shape[0], right.shape[1]))
    multiply(left, right, out)
    return out


@kernel
def products(left, right, out):
    """Fill ``out`` (B, M, N) with the products of ``left`` (B, M, K) and ``right`` (B, K, N)."""
    for b in range(len(left)):
        multiply(left[b], right[b], out[b])


@device
def eliminate(matrix, right):
    """Make ``matrix`` (N, N) upper triangular, and the same of ``right`` (N, M); return whether it has an inverse."""
    size, columns = right.shape
    for k in range(size):
        pivot, largest = k, abs(matrix[k, k])
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > largest:
                pivot, largest = i, abs(matrix[i, k])
        if not largest > 0.0:
            return False
        if pivot != k:
            for j in range(size):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(columns):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, size):
                matrix[i, j] -= factor * matrix[k, j]
            for j in range(columns):
                right[i, j] -= factor * right[k, j]
    return True


@device
def substitute(upper, right):
    """Replace ``right`` (N, M) by the solution of U X = right, U (N, N) upper triangular."""
    size, columns = right.shape
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            for j in range(columns):
                right[i, j] -= upper[i, k] * right[k, j]
        for j in range(columns):
            right[i, j] /= upper[i, i]


@kernel
def solve(matrices, right):
    """Replace ``right`` (B, N, M) by the solutions X of A X = right; ``matrices`` (B, N, N) become their upper factors.

    Elimination with the largest pivot of each column, the first of equal ones. Returns the index of the first singular
    matrix, -1 if there is none.
    """
    for b in range(len(matrices)):
        if not eliminate(matrices[b], right[b]):
            return b
        substitute(matrices[b], right[b])
    return -1


@device
def _rotation(first, second, between):
    """Return cosine and sine that turn the off-diagonal element ``between`` of a symmetric 2 x 2 matrix to zero."""
    slope = (second - first) / (2.0 * between)
    tangent = (1.0 if slope >= 0.0 else -1.0) / (abs(slope) + np.sqrt(slope * slope + 1.0))
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    return cosine, tangent * cosine


@kernel
def eigen(matrices, vectors):
    """Turn symmetric ``matrices`` (B, N, N) into diagonal ones, and fill ``vectors`` with eigenvectors as columns.

    Jacobi's rotations, by rows, until what is off the diagonal is rounding (Golub and Van Loan, section 8.5).
    """
    count, size, _ = matrices.shape
    for b in range(count):
        for i in range(size):
            for j in range(size):
                vectors[b, i, j] = 1.0 if i == j else 0.0
        norm = 0.0
        for i in range(size):
            norm = max(norm, abs(matrices[b, i, i]))
        for _ in range(_MOST_SWEEPS):
            turned = False
            for p in range(size - 1):
                for q in range(p + 1, size):
                    between = matrices[b, p, q]
                    scale = np.sqrt(abs(matrices[b, p, p]) * abs(matrices[b, q, q]))
                    if not abs(between) > max(_ROUNDING * scale, _ROUNDING * _ROUNDING * norm):
                        continue
                    turned = True
                    cosine, sine = _rotation(matrices[b, p, p], matrices[b, q, q], between)
                    for k in range(size):
                        one, other = matrices[b, k, p], matrices[b, k, q]
                        matrices[b, k, p] = cosine * one - sine * other
                        matrices[b, k, q] = sine * one + cosine * other
                    for k in range(size):
                        one, other = matrices[b, p, k], matrices[b, q, k]
                        matrices[b, p, k] = cosine * one - sine * other
                        matrices[b, q, k] = sine * one + cosine * other
                    matrices[b, p, q] = 0.0
                    matrices[b, q, p] = 0.0
                    for k in range(size):
                        one, other = vectors[b, k, p], vectors[b, k, q]
                        vectors[b, k, p] = cosine * one - sine * other
                        vectors[b, k, q] = sine * one + cosine * other
            if not turned:
                break


@kernel
def singular(matrix, vectors):
    """Turn the columns of ``matrix`` (M, N) orthogonal, and fill ``vectors`` (N, N) with what turned them.

    One-sided rotations (Hestenes, 1958): the columns' lengths are the singular values, the columns of ``vectors`` the
    right singular vectors; small values keep their relative accuracy.
    """
    rows, size = matrix.shape
    for i in range(size):
        for j in range(size):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(_MOST_SWEEPS):
        turned = False
        for p in range(size - 1):
            for q in range(p + 1, size):
                first, second, between = 0.0, 0.0, 0.0
                for k in range(rows):
                    first += matrix[k, p] * matrix[k, p]
                    second += matrix[k, q] * matrix[k, q]
                    between += matrix[k, p] * matrix[k, q]
                if not abs(between) > _ROUNDING * np.sqrt(first * second):
                    continue
                turned = True
                cosine, sine = _rotation(first, second, between)
                for k in range(rows):
                    one, other = matrix[k, p], matrix[k, q]
                    matrix[k, p] = cosine * one - sine * other
                    matrix[k, q] = sine * one + cosine * other
                for k in range(size):
                    one, other = vectors[k, p], vectors[k, q]
                    vectors[k, p] = cosine * one - sine * other
                    vectors[k, q] = sine * one + cosine * other
        if not turned:
            break
