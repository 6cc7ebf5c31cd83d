"""Small linear algebra against LAPACK's results, and by what defines each."""

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dynpf import portable

ANY = settings(derandomize=True, deadline=None, max_examples=60)

SIZES = st.integers(1, 15)
SEEDS = st.integers(0, 2**32 - 1)


def matrices(seed: int, *shape: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(size=shape)


def covariances(seed: int, count: int, size: int) -> NDArray[np.float64]:
    root = matrices(seed, count, size, size)
    return root @ np.swapaxes(root, 1, 2) + 1e-3 * np.eye(size)


@ANY
@given(SEEDS, SIZES, SIZES, SIZES)
def test_products_of_matrices_vectors_and_stacks_are_those_of_blas(seed: int, m: int, k: int, n: int) -> None:
    left, right, row = matrices(seed, m, k), matrices(seed + 1, k, n), matrices(seed + 2, m)
    stack = matrices(seed + 3, 4, k, n)
    np.testing.assert_allclose(portable.product(left, right), left @ right, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(portable.product(left, right[:, 0]), left @ right[:, 0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(portable.product(row, left, right), row @ left @ right, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        portable.product(row, left, right[:, 0]), row @ left @ right[:, 0], rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(portable.product(left, stack), left @ stack, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(portable.product(left, stack)[2], portable.product(left, stack[2]))


@ANY
@given(SEEDS, SIZES, st.integers(1, 4))
def test_solutions_and_inverses_undo_the_product(seed: int, size: int, count: int) -> None:
    matrix, right = covariances(seed, count, size), matrices(seed, count, size, 2)
    np.testing.assert_allclose(matrix @ portable.solve(matrix, right), right, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(matrix[0] @ portable.solve(matrix[0], right[0, :, 0]), right[0, :, 0], atol=1e-6)
    np.testing.assert_allclose(portable.inverse(matrix), np.linalg.inv(matrix), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(portable.log_determinant(matrix), np.linalg.slogdet(matrix)[1], rtol=1e-9, atol=1e-9)


def test_a_matrix_whose_first_pivot_is_zero_is_solved_too() -> None:
    np.testing.assert_array_equal(portable.solve([[0.0, 2.0], [4.0, 0.0]], [2.0, 8.0]), [2.0, 1.0])


@pytest.mark.parametrize("matrix", [[[1.0, 2.0], [2.0, 4.0]], [[0.0]], [[np.nan, 1.0], [1.0, np.nan]]])
def test_a_matrix_without_an_inverse_is_refused_and_shown(matrix: list[list[float]]) -> None:
    with pytest.raises(portable.SingularMatrixError, match="no inverse"):
        portable.inverse(matrix)


@pytest.mark.parametrize("shapes", [((2, 3), (2, 3)), ((2, 2), (3,)), ((3,), (2, 2))])
def test_shapes_that_do_not_fit_are_named(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    left, right = (np.ones(shape) for shape in shapes)
    with pytest.raises(ValueError, match=r"\(.*do not fit"):
        portable.product(left, right)
    if left.ndim == 2:
        with pytest.raises(ValueError, match="do not fit"):
            portable.solve(left, right)


@ANY
@given(SEEDS, SIZES)
def test_eigenvalues_are_lapacks_and_vectors_make_the_matrix_again(seed: int, size: int) -> None:
    matrix = matrices(seed, 3, size, size)
    matrix = matrix + np.swapaxes(matrix, 1, 2)
    values, vectors = portable.eigh(matrix)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix), rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose((vectors * values[:, None, :]) @ np.swapaxes(vectors, 1, 2), matrix, atol=1e-11)
    np.testing.assert_allclose(
        np.swapaxes(vectors, 1, 2) @ vectors, np.broadcast_to(np.eye(size), matrix.shape), atol=1e-12
    )
    largest = np.take_along_axis(vectors, np.argmax(np.abs(vectors), axis=1)[:, None], axis=1)
    assert (largest > 0.0).all()


def test_eigenvectors_of_a_singular_matrix_are_found() -> None:
    values, vectors = portable.eigh([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(values, [0.0, 0.0, 2.0], atol=1e-15)
    np.testing.assert_allclose(np.abs(vectors[:, 2]), [0.5**0.5, 0.5**0.5, 0.0], atol=1e-15)


@ANY
@given(SEEDS, st.integers(1, 12), st.integers(0, 30))
def test_singular_values_are_lapacks_also_of_a_matrix_of_less_than_full_rank(seed: int, size: int, more: int) -> None:
    matrix = matrices(seed, size + more, size)
    matrix[:, 0] = matrix[:, -1]
    values, vectors = portable.singular_values(matrix)
    exact = np.linalg.svd(matrix, compute_uv=False)
    np.testing.assert_allclose(values, exact, atol=1e-13 * exact[0] * (size + more))
    np.testing.assert_allclose(np.linalg.norm(matrix @ vectors, axis=0), values, atol=1e-12 * exact[0])


def test_the_bits_are_those_of_every_other_machine() -> None:
    """Not against an oracle: what a machine computes here, each must."""
    stack = np.linspace(-1.0, 1.0, 20 * 49).reshape(20, 7, 7) % 0.37 + 3.0 * np.eye(7)
    symmetric = stack + np.swapaxes(stack, 1, 2)
    digest = hashlib.sha256()
    for found in (
        portable.product(stack, symmetric),
        portable.inverse(stack),
        *portable.eigh(symmetric),
        *portable.singular_values(stack.reshape(-1, 7)),
        portable.log_determinant(stack),
        portable.norm(stack, axis=1),
    ):
        digest.update(np.ascontiguousarray(found).tobytes())
    assert digest.hexdigest() == "bbc3b260f71641f13c199cee25a918c772b4b8a0287fee907c1151bc5812934d"
