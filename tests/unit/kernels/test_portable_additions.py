"""e^x - 1, log(e^a + e^b) and the normal quantile, where cancellation or overflow would spoil the plain formulas."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from dynpf.portable import expm1, logaddexp, normal_quantile


def test_expm1_keeps_its_digits_where_it_is_small_and_its_limits_where_it_is_not() -> None:
    random = np.random.default_rng(0)
    values = np.concatenate([random.uniform(-40.0, 40.0, 20_000), 10.0 ** random.uniform(-300.0, 0.0, 20_000)])
    assert np.all(np.abs(expm1(values) - np.expm1(values)) <= 3.0 * np.spacing(np.abs(np.expm1(values))))
    assert expm1(-values)[-1] == np.expm1(-values)[-1]
    assert (expm1(-800.0), expm1(800.0), expm1(0.0)) == (-1.0, math.inf, 0.0)
    assert math.isnan(expm1(math.nan))


@pytest.mark.parametrize("pair", [(1.0, 2.0), (-1000.0, 1000.0), (-math.inf, 3.0), (-math.inf, -math.inf)])
def test_logaddexp_of_numbers_and_of_arrays_is_numpys(pair: tuple[float, float]) -> None:
    assert logaddexp(*pair) == pytest.approx(np.logaddexp(*pair), rel=1e-15)
    assert logaddexp(np.array([pair[0]]), np.array([pair[1]]))[0] == logaddexp(*pair)


def test_an_infinite_summand_makes_an_infinite_sum() -> None:
    assert logaddexp(math.inf, math.inf) == math.inf
    assert logaddexp(np.array([math.inf]), np.array([0.0]))[0] == math.inf


@pytest.mark.parametrize("probability", [1e-300, 1e-12, 0.01, 0.075, 0.3, 0.5, 0.925, 0.99, 1.0 - 1e-12])
def test_the_normal_quantile_is_that_of_the_standard_library(probability: float) -> None:
    assert normal_quantile(probability) == pytest.approx(NormalDist().inv_cdf(probability), rel=2e-15, abs=1e-300)


@pytest.mark.parametrize("probability", [0.0, 1.0, math.nan])
def test_a_probability_out_of_range_has_no_quantile(probability: float) -> None:
    with pytest.raises(ValueError, match="more than 0 and less than 1"):
        normal_quantile(probability)
