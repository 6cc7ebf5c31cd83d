"""The Gaussian that readings leave of the motion's noise, one a particle: its precision, its draws, and their weights.

Arrays have the particles last, so that loops over a block of them become vectors; matrices are small. All is float64.
Much of a state neither moves at random with the rest nor is seen by a reading, such as a calibration: an element of a
matrix that is zero for a whole block of particles is left out of its sums, which would not change by it.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary64 import log
from dynpf.kernels.philox import BLOCK

__all__ = ["add_reading", "draw", "roots"]

_ROUNDING = 1e-12
"""Share of its own variance below which a pivot is rounding: the direction is a combination of those before it."""


@device
def _subtract_product(first, second, out):
    for p in range(out.size):
        out[p] -= first[p] * second[p]


@device
def _add_product(first, second, out):
    for p in range(out.size):
        out[p] += first[p] * second[p]


@device
def _add_multiple(factor, values, out):
    for p in range(out.size):
        out[p] += factor * values[p]


@device
def _fill(value, out):
    for p in range(out.size):
        out[p] = value


@device
def _copy(values, out):
    for p in range(out.size):
        out[p] = values[p]


@device
def _add_constant(value, out):
    for p in range(out.size):
        out[p] += value


@device
def _lower_by_half(first, second, out):
    for p in range(out.size):
        out[p] -= 0.5 * (first[p] * second[p])


@device
def _divide(divisor, out):
    for p in range(out.size):
        out[p] /= divisor[p]


@device
def _add(first, second, out):
    for p in range(out.size):
        out[p] = first[p] + np.float64(second[p])


@device
def _add_log(values, out):
    for p in range(out.size):
        out[p] += log(values[p])


@device
def _add_half_difference(first, second, out):
    """Add half the difference of squares."""
    for p in range(out.size):
        a = np.float64(first[p])
        out[p] += 0.5 * (a * a - second[p] * second[p])


@device
def _subtract(values, out):
    for p in range(out.size):
        out[p] -= values[p]


@device
def _any(values):
    """Return whether any value is not zero."""
    found = False
    for p in range(values.size):
        found |= values[p] != 0.0
    return found


@device
def _all_one(values):
    other = False
    for p in range(values.size):
        other |= values[p] != 1.0
    return not other


@device
def _pivot_roots(pivot, own):
    """Replace pivots by their roots; by zero where a pivot is a rounding of its own element of the diagonal."""
    for p in range(pivot.size):
        flat = pivot[p] <= _ROUNDING * max(own[p], 0.0)
        pivot[p] = 0.0 if flat else np.sqrt(1.0 if flat else pivot[p])


@device
def _divide_by_pivot_root(root, out):
    """Divide by the roots of pivots; zero where the root is."""
    for p in range(out.size):
        flat = root[p] == 0.0
        out[p] = 0.0 if flat else out[p] / (1.0 if flat else root[p])


@device
def _root(matrices, start, pivot, out, first, filled):
    """Fill n columns of ``out`` (D, D, .) from ``first`` on with lower triangular L, L L^T = A, and ``filled`` (D, D)
    with which elements of L are not zero for all.

    A are those of positive semi-definite ``matrices`` (D, D, N) from ``start`` on; ``pivot`` (n,) is overwritten.
    """
    size, stop, end = len(matrices), start + pivot.size, first + pivot.size
    filled[:] = False
    for j in range(size):
        for i in range(j):
            _fill(0.0, out[i, j, first:end])
        for i in range(j, size):
            element = out[i, j, first:end]
            _copy(matrices[i, j, start:stop], element)
            filled[i, j] = i == j or _any(element)
            for k in range(j):
                if filled[i, k] and filled[j, k]:
                    _subtract_product(out[i, k, first:end], out[j, k, first:end], element)
                    filled[i, j] = True
        _copy(out[j, j, first:end], pivot)
        _pivot_roots(pivot, matrices[j, j, start:stop])
        for i in range(j, size):
            if filled[i, j]:
                _divide_by_pivot_root(pivot, out[i, j, first:end])
        filled[j, j] = _any(out[j, j, first:end])


@kernel
def roots(matrices, out):
    """Fill ``out`` (D, D, N) with lower triangular L, L L^T = A of positive semi-definite ``matrices`` (D, D, N).

    Columns of directions without variance are zero.
    """
    size, _, count = matrices.shape
    pivot, filled = np.empty(BLOCK), np.empty((size, size), dtype=np.bool_)
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        _root(matrices, start, pivot[: stop - start], out, start, filled)


@device
def _slopes(root, jacobian, start, stop, out, sloping):
    """Fill ``out`` (M, D, .) with A = H L of particles ``start`` to ``stop``, and ``sloping`` (M, D) with which of its
    elements are not zero for all."""
    rows, size, _ = jacobian.shape
    sloping[:] = False
    for e in range(size):
        for m in range(rows):
            _fill(0.0, out[m, e, : stop - start])
        for d in range(e, size):
            moved = root[d, e, start:stop]
            if _any(moved):
                for m in range(rows):
                    if _any(jacobian[m, d, start:stop]):
                        _add_product(jacobian[m, d, start:stop], moved, out[m, e, : stop - start])
                        sloping[m, e] = True


@kernel
def add_reading(root, jacobian, innovation, information, log_peak, precision, pull, log_density):
    """Add the information of a reading about the standard normal noise e of a motion f + L e.

    Of ``root`` L (D, D, N) lower triangular, ``jacobian`` H (M, D, N), ``innovation`` v (M, N) and ``information``
    R^-1 (M, M): A^T R^-1 A with A = H L to ``precision`` (D, D, N), A^T R^-1 v to ``pull`` (D, N), and
    ``log_peak`` - v^T R^-1 v / 2 to ``log_density`` (N,).
    """
    rows, size, count = jacobian.shape
    slope, sloping = np.empty((rows, size, BLOCK)), np.empty((rows, size), dtype=np.bool_)
    mixed = np.empty(BLOCK)
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        n = stop - start
        _add_constant(log_peak, log_density[start:stop])
        _slopes(root, jacobian, start, stop, slope, sloping)
        for m in range(rows):
            _fill(0.0, mixed[:n])
            for k in range(rows):
                if information[m, k] != 0.0:
                    _add_multiple(information[m, k], innovation[k, start:stop], mixed[:n])
            _lower_by_half(innovation[m, start:stop], mixed[:n], log_density[start:stop])
            for e in range(size):
                if sloping[m, e]:
                    _add_product(slope[m, e, :n], mixed[:n], pull[e, start:stop])
            for e in range(size):
                _fill(0.0, mixed[:n])
                for k in range(rows):
                    if information[m, k] != 0.0 and sloping[k, e]:
                        _add_multiple(information[m, k], slope[k, e, :n], mixed[:n])
                for d in range(size):
                    if sloping[m, d]:
                        _add_product(slope[m, d, :n], mixed[:n], precision[d, e, start:stop])


@kernel
def draw(expected, root, precision, pull, standard, drawn, gain, log_determinant, log_ratio):
    """Fill ``drawn`` (D, N) with f + L e of ``expected`` f (D, N) and ``root`` L (D, D, N), e drawn from the Gaussian
    of ``precision`` P (D, D, N) and mean P^-1 b, ``pull`` b (D, N), by standard normal numbers (D, N), float32.

    Fills, each (N,), ``gain`` with b^T P^-1 b, ``log_determinant`` with 0.5 log det P, and ``log_ratio`` with the
    log-density of e as the motion has it, less that which it was drawn from.
    """
    size, count = expected.shape
    lower, pivot, filled = np.empty((size, size, BLOCK)), np.empty(BLOCK), np.empty((size, size), dtype=np.bool_)
    whitened, noise = np.empty((size, BLOCK)), np.empty((size, BLOCK))
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        n = stop - start
        _root(precision, start, pivot[:n], lower, 0, filled)
        squared, logs, ratio = gain[start:stop], log_determinant[start:stop], log_ratio[start:stop]
        _fill(0.0, squared)
        _fill(0.0, logs)
        _fill(0.0, ratio)
        for i in range(size):
            _copy(pull[i, start:stop], whitened[i, :n])
            for k in range(i):
                if filled[i, k]:
                    _subtract_product(lower[i, k, :n], whitened[k, :n], whitened[i, :n])
            if _all_one(lower[i, i, :n]):
                _add_product(whitened[i, :n], whitened[i, :n], squared)
                continue
            _divide(lower[i, i, :n], whitened[i, :n])
            _add_product(whitened[i, :n], whitened[i, :n], squared)
            _add_log(lower[i, i, :n], logs)
        for i in range(size - 1, -1, -1):
            _add(whitened[i, :n], standard[i, start:stop], noise[i, :n])
            for k in range(i + 1, size):
                if filled[k, i]:
                    _subtract_product(lower[k, i, :n], noise[k, :n], noise[i, :n])
            _divide(lower[i, i, :n], noise[i, :n])
        for i in range(size):
            _add_half_difference(standard[i, start:stop], noise[i, :n], ratio)
            _copy(expected[i, start:stop], drawn[i, start:stop])
            for k in range(i + 1):
                if _any(root[i, k, start:stop]):
                    _add_product(root[i, k, start:stop], noise[k, :n], drawn[i, start:stop])
        _subtract(logs, ratio)
