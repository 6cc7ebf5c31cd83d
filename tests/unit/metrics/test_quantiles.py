"""Quantiles against SciPy's."""

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from dynpf.metrics.quantiles import chi_square_quantile, normal_quantile, student_t_quantile

PROBABILITIES = [1e-6, 0.001, 0.025, 0.05, 0.3, 0.5, 0.7, 0.95, 0.975, 0.999, 1 - 1e-6]


@pytest.mark.parametrize("degrees", [1, 2, 3, 6, 7.5, 39, 40, 41, 100, 1998, 15_000, 1_000_000])
def test_chi_square(degrees: float) -> None:
    found = [chi_square_quantile(probability, degrees) for probability in PROBABILITIES]
    assert found == pytest.approx(stats.chi2.ppf(PROBABILITIES, degrees), rel=1e-10)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.floats(1e-8, 1 - 1e-8), st.floats(0.2, 5000.0))
def test_chi_square_is_the_inverse_of_its_distribution(probability: float, degrees: float) -> None:
    quantile = chi_square_quantile(probability, degrees)
    assert stats.chi2.cdf(quantile, degrees) == pytest.approx(probability, rel=1e-10)
    assert stats.chi2.sf(quantile, degrees) == pytest.approx(1.0 - probability, rel=1e-7)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 9, 10, 19, 99, 100, 1000, 5001])
def test_student_t(degrees: int) -> None:
    inner = PROBABILITIES[1:-1]
    found = [student_t_quantile(probability, degrees) for probability in inner]
    assert found == pytest.approx(stats.t.ppf(inner, degrees), rel=1e-10, abs=1e-12)


def test_normal() -> None:
    assert [normal_quantile(p) for p in PROBABILITIES] == pytest.approx(stats.norm.ppf(PROBABILITIES), rel=1e-12)


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, float("nan")])
def test_a_probability_out_of_range_is_refused(probability: float) -> None:
    calls: tuple[Callable[[], float], ...] = (
        lambda: normal_quantile(probability),
        lambda: chi_square_quantile(probability, 3),
        lambda: student_t_quantile(probability, 3),
    )
    for call in calls:
        with pytest.raises(ValueError, match="probability = "):
            call()


def test_degrees_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="degrees = 0"):
        chi_square_quantile(0.5, 0)
    with pytest.raises(ValueError, match="degrees = 0"):
        student_t_quantile(0.5, 0)
