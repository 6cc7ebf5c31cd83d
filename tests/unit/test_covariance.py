"""Roots of covariances of any rank, and triangular systems, against NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynpf.covariance import cholesky, semidefinite_root, solve_lower, solve_upper


@given(st.integers(1, 5), st.integers(0, 5), st.integers(0, 1000))
def test_the_root_of_a_covariance_of_any_rank_gives_it_back(dimension: int, rank: int, seed: int) -> None:
    factor = np.random.default_rng(seed).standard_normal((dimension, rank))
    covariance = factor @ factor.T
    root = semidefinite_root(covariance)
    assert root @ root.T == pytest.approx(covariance, abs=1e-9)
    assert np.array_equal(root, np.tril(root))


def test_units_that_differ_by_much_lose_no_noise() -> None:
    assert semidefinite_root(np.diag([1e12, 1e-12, 0.0])) == pytest.approx(np.diag([1e6, 1e-6, 0.0]), rel=1e-12)


@given(st.integers(1, 5), st.integers(0, 5), st.integers(0, 1000))
def test_many_roots_at_once_are_those_of_each(dimension: int, rank: int, seed: int) -> None:
    factors = np.random.default_rng(seed).standard_normal((7, dimension, rank))
    covariances = np.einsum("nik,njk->ijn", factors, factors)
    roots = cholesky(covariances)
    for k in range(7):
        assert roots[..., k] == pytest.approx(semidefinite_root(covariances[..., k]), abs=1e-5)


@given(st.integers(1, 5), st.integers(0, 1000))
def test_triangular_systems_are_solved(dimension: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    lower = np.tril(draw.standard_normal((6, dimension, dimension))) + 3.0 * np.eye(dimension)
    right = draw.standard_normal((dimension, 6))
    stacked = np.moveaxis(lower, 0, -1)
    for k in range(6):
        assert solve_lower(stacked, right)[:, k] == pytest.approx(np.linalg.solve(lower[k], right[:, k]))
        assert solve_upper(stacked, right)[:, k] == pytest.approx(np.linalg.solve(lower[k].T, right[:, k]))
