"""Roots of covariances of any rank."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.covariance import semidefinite_root


@settings(deadline=None)  # the first call may compile
@given(st.integers(1, 5), st.integers(0, 5), st.integers(0, 1000))
def test_the_root_of_a_covariance_of_any_rank_gives_it_back(dimension: int, rank: int, seed: int) -> None:
    factor = np.random.default_rng(seed).standard_normal((dimension, rank))
    covariance = factor @ factor.T
    root = semidefinite_root(covariance)
    assert root @ root.T == pytest.approx(covariance, abs=1e-9)
    assert np.array_equal(root, np.tril(root))


@pytest.mark.parametrize("seed", [37, 509, 797])
def test_a_small_pivot_makes_no_rounding_large(seed: int) -> None:
    """The second pivot of these is 4e-5 or less of its variance: taken as they come, what is left looks negative."""
    factor = np.random.default_rng(seed).standard_normal((5, 2))
    covariance = factor @ factor.T
    root = semidefinite_root(covariance)
    assert root @ root.T == pytest.approx(covariance, abs=1e-14)
    assert np.array_equal(root, np.tril(root))


def test_units_that_differ_by_much_lose_no_noise() -> None:
    assert semidefinite_root(np.diag([1e12, 1e-12, 0.0])) == pytest.approx(np.diag([1e6, 1e-6, 0.0]), rel=1e-12)


@pytest.mark.parametrize("covariance", [np.diag([1.0, -1.0]), np.array([[1.0, 2.0], [2.0, 1.0]]), 1.0 - np.eye(2)])
def test_a_negative_eigenvalue_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(ValueError, match="no negative eigenvalue"):
        semidefinite_root(covariance)
