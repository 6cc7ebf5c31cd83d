"""The elementary functions against mpmath's exact values; the bounds are those that elementary64 states."""

import hashlib
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dynpf import portable

ANY = settings(derandomize=True, deadline=None, max_examples=60)

Values = NDArray[np.float64]


def ulps(found: Values, exact: Callable[..., mpmath.mpf], *arguments: Values) -> float:
    """Return the largest error of what was found in units in the last place of the exact value."""
    worst = 0.0
    with mpmath.workprec(200):
        for index, value in enumerate(found):
            true = exact(*(mpmath.mpf(float(each[index])) for each in arguments))
            worst = max(worst, float(abs(mpmath.mpf(float(value)) - true) / float(np.spacing(abs(float(true))))))
    return worst


def numbers(low: float, high: float, count: int = 1000) -> Values:
    return np.random.default_rng(1).uniform(low, high, count)


def sizes(count: int = 1000) -> Values:
    """Numbers of all sizes and both signs."""
    random = np.random.default_rng(2)
    return random.choice((-1.0, 1.0), count) * 10.0 ** random.uniform(-300.0, 5.0, count)


@pytest.mark.parametrize(
    ("function", "exact", "values", "bound"),
    [
        (portable.sin, mpmath.sin, numbers(-10.0, 10.0), 0.8),
        (portable.cos, mpmath.cos, numbers(-10.0, 10.0), 0.8),
        (portable.sin, mpmath.sin, numbers(-1.6e6, 1.6e6), 0.8),
        (portable.cos, mpmath.cos, numbers(-1.6e6, 1.6e6), 0.8),
        (portable.sin, mpmath.sin, sizes(), 0.8),
        (portable.tan, mpmath.tan, numbers(-100.0, 100.0), 2.2),
        (portable.exp, mpmath.exp, numbers(-700.0, 709.0), 0.9),
        (portable.log, mpmath.log, numbers(0.5, 2.0), 0.9),
        (portable.log, mpmath.log, abs(sizes()), 0.9),
        (portable.log1p, mpmath.log1p, numbers(-0.99, 10.0), 1.5),
        (portable.log1p, mpmath.log1p, sizes()[abs(sizes()) < 0.9], 1.5),
        (portable.erf, mpmath.erf, numbers(-5.0, 5.0, 300), 20.0),
    ],
)
def test_a_function_is_within_its_bound_of_the_exact_value(
    function: Callable[[Values], Values], exact: Callable[..., mpmath.mpf], values: Values, bound: float
) -> None:
    assert 0.0 < ulps(function(values), exact, values) <= bound


def test_directions_and_lengths_are_within_their_bounds_in_all_quadrants_and_of_all_sizes() -> None:
    y, x = np.concatenate([numbers(-5.0, 5.0), sizes()]), np.concatenate([numbers(-5.0, 5.0)[::-1], sizes()[::-1]])
    assert ulps(portable.atan2(y, x), mpmath.atan2, y, x) <= 1.5
    assert ulps(portable.hypot(y, x), mpmath.hypot, y, x) <= 1.2


@ANY
@given(st.floats(), st.floats())
def test_special_values_are_those_of_ieee_754(y: float, x: float) -> None:
    with np.errstate(all="ignore"):
        assert portable.atan2(y, x) == pytest.approx(np.arctan2(y, x), rel=1e-15, abs=1e-320, nan_ok=True)
        assert portable.hypot(y, x) == pytest.approx(np.hypot(y, x), rel=1e-15, abs=1e-320, nan_ok=True)
        assert portable.exp(x) == pytest.approx(np.exp(x), rel=1e-15, abs=1e-320, nan_ok=True)
        assert portable.log(x) == pytest.approx(np.log(x), rel=1e-15, nan_ok=True)
        assert np.isnan(portable.sin(x)) == np.isnan(np.sin(x))


@ANY
@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_one_number_and_many_give_the_same_bits_in_any_layout(values: list[float]) -> None:
    array = np.array(values)
    padded = np.zeros((len(values), 3))
    padded[:, 1] = array
    for function in (portable.sin, portable.cos, portable.exp, portable.tan, portable.log, portable.erf):
        alone = np.array([function(value) for value in values])
        np.testing.assert_array_equal(function(array), alone)
        np.testing.assert_array_equal(function(padded[:, 1]), alone)
    assert portable.sincos(values[0]) == (portable.sin(values[0]), portable.cos(values[0]))


def test_logarithms_of_sums_do_not_overflow() -> None:
    values = np.array([[1000.0, -1e9, -np.inf], [1000.0, -1e9, -np.inf]])
    np.testing.assert_allclose(portable.logaddexp(*values), [1000.0 + np.log(2.0), -1e9 + np.log(2.0), -np.inf])


@ANY
@given(st.floats(), st.integers(-5, 5), st.integers(6, 300))
def test_a_whole_number_lies_within_its_bounds_whatever_it_is_made_of(value: float, low: int, high: int) -> None:
    found = int(portable.whole(np.array([value]), low, high)[0])
    assert low <= found <= high
    if low <= value <= high:
        assert found == int(value)


def test_whole_numbers_are_of_the_kind_that_is_asked_for_and_of_float32_keep_large_bounds() -> None:
    levels = portable.whole(np.array([-3.0, np.nan, 254.9, 1e9]), 0, 255, np.uint8)
    assert levels.dtype == np.uint8
    assert levels.tolist() == [0, 0, 254, 255]
    assert portable.whole(np.array([np.inf, -np.inf], np.float32), -(2**31), 2**31 - 1, np.int32).tolist() == [
        2**31 - 1,
        -(2**31),
    ]


def test_the_bits_are_those_of_every_other_machine() -> None:
    """Not against an oracle: what a machine computes here, each must."""
    values = np.linspace(-700.0, 700.0, 100_001)
    digest = hashlib.sha256()
    for function in (portable.sin, portable.cos, portable.tan, portable.exp, portable.erf):
        digest.update(function(values).tobytes())
    digest.update(portable.log(np.abs(values) + 1e-9).tobytes() + portable.log1p(np.abs(values)).tobytes())
    digest.update(portable.atan2(values, values[::-1] * 0.3).tobytes() + portable.hypot(values, values[::-1]).tobytes())
    assert digest.hexdigest() == "a5bace13a9d7c39f9ad6918074a48fae5e88ee0b1e8a522923f1fd8be9d6c5d7"
