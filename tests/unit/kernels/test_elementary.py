"""The elementary functions of the kernels against NumPy in float64: errors over their ranges, and special values."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from dynpf.kernels import elementary
from dynpf.kernels.compiler import kernel

Float32s = NDArray[np.float32]
PI = np.float32(np.pi)


@kernel
def sincos_of(angles: Float32s, sines: Float32s, cosines: Float32s) -> None:
    for i in range(angles.size):
        sines[i], cosines[i] = elementary.sincos(angles[i])


@kernel
def exp_of(values: Float32s, results: Float32s) -> None:
    for i in range(values.size):
        results[i] = elementary.exp(values[i])


@kernel
def log_of(values: Float32s, results: Float32s) -> None:
    for i in range(values.size):
        results[i] = elementary.log(values[i])


@kernel
def wrap_of(values: Float32s, results: Float32s) -> None:
    for i in range(values.size):
        results[i] = elementary.wrap(values[i])


@kernel
def atan2_of(ys: Float32s, xs: Float32s, results: Float32s) -> None:
    for i in range(xs.size):
        results[i] = elementary.atan2(ys[i], xs[i])


def mapped(function: Callable[..., None], *arguments: object, outputs: int = 1) -> tuple[Float32s, ...]:
    given = [np.array(argument, dtype=np.float32) for argument in arguments]
    results = [np.empty_like(given[0]) for _ in range(outputs)]
    function(*given, *results)
    return tuple(results)


def ulps(found: Float32s, exact: NDArray[np.float64]) -> float:
    """Return the largest error in units in the last place of the exact value."""
    return float(np.max(np.abs(found - exact) / np.spacing(np.abs(exact).astype(np.float32))))


def spread(low: float, high: float, count: int = 300_000) -> Float32s:
    return np.random.default_rng(1).uniform(low, high, count).astype(np.float32)


def quarter_turns(largest: int) -> Float32s:
    """Return the multiples of pi/2, where one of sine and cosine is zero, and their neighbours in float32."""
    nearest = (np.arange(-largest, largest + 1) * np.pi / 2).astype(np.float32)
    return np.concatenate((nearest, np.nextafter(nearest, -PI * 4), np.nextafter(nearest, PI * 4)))


@pytest.mark.parametrize("largest", [0.8, 10.0])
def test_sine_and_cosine_are_within_two_units_in_the_last_place(largest: float) -> None:
    angles = spread(-largest, largest)
    sines, cosines = mapped(sincos_of, angles, outputs=2)
    assert ulps(sines, np.sin(angles.astype(float))) < 2.0
    assert ulps(cosines, np.cos(angles.astype(float))) < 2.0


def test_sine_and_cosine_of_many_turns_are_within_two_roundings_of_one() -> None:
    angles = np.concatenate((spread(-8000.0, 8000.0), quarter_turns(5000)))
    sines, cosines = mapped(sincos_of, angles, outputs=2)
    assert np.abs(sines - np.sin(angles.astype(float))).max() < 1.6 * 2.0**-24
    assert np.abs(cosines - np.cos(angles.astype(float))).max() < 1.6 * 2.0**-24
    assert np.abs(np.hypot(sines.astype(float), cosines) - 1.0).max() < 2.0**-23


def test_the_bound_on_the_error_would_notice_a_worse_series() -> None:
    """A control: Taylor's series of the same length, at the end of its range."""
    angle = np.linspace(0.5, np.pi / 4, 1000).astype(np.float32)
    taylor = angle - angle**3 / 6 + angle**5 / 120 - angle**7 / 5040
    assert ulps(taylor.astype(np.float32), np.sin(angle.astype(float))) > 4.0


def test_exponential_is_within_one_unit_in_the_last_place() -> None:
    for values in (spread(-87.0, 88.0), spread(-1.0, 1.0), spread(-1e-3, 1e-3)):
        (found,) = mapped(exp_of, values)
        assert ulps(found, np.exp(values.astype(float))) < 1.0


def test_exponential_ends_in_zero_below_and_in_a_finite_number_above() -> None:
    (found,) = mapped(exp_of, [0.0, -0.0, -87.5, -1e30, -np.inf, 89.0, np.inf, np.nan])
    assert found[:5].tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]
    assert found[5] == found[6] == pytest.approx(np.exp(88.0), rel=1e-6)
    assert np.isnan(found[7])


def test_logarithm_is_within_one_unit_in_the_last_place() -> None:
    for values in (np.exp(spread(-87.3, 88.7).astype(float)).astype(np.float32), spread(0.5, 2.0)):
        (found,) = mapped(log_of, values)
        assert ulps(found, np.log(values.astype(float))) < 1.0


def test_logarithm_of_no_positive_number_is_that_of_the_smallest() -> None:
    smallest = np.log(float(np.finfo(np.float32).tiny))
    (found,) = mapped(log_of, [0.0, -0.0, 1e-45, -3.0, -np.inf, np.nan])
    assert found == pytest.approx([smallest] * 6, rel=1e-6)
    (found,) = mapped(log_of, [1.0, np.inf])
    assert found == pytest.approx([0.0, 128 * np.log(2.0)], rel=1e-6)


def test_direction_is_within_two_units_in_the_last_place_and_a_bit() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.standard_normal((2, 300_000)).astype(np.float32)
    scales = np.exp(rng.uniform(-30, 30, (2, 300_000))).astype(np.float32)
    for across, along in ((y, x), (y * scales[0], x * scales[1])):
        (found,) = mapped(atan2_of, across, along)
        assert ulps(found, np.arctan2(across.astype(float), along.astype(float))) < 2.1


def test_direction_along_the_axes_and_of_nothing() -> None:
    ys = [0.0, 0.0, -0.0, 0.0, -0.0, 2.0, -2.0, 0.0, -0.0, 1e-45, -1e-45]
    xs = [0.0, -0.0, 0.0, 2.0, 2.0, 0.0, 0.0, -2.0, -2.0, 0.0, -1.0]
    (found,) = mapped(atan2_of, ys, xs)
    assert found.tolist() == [0.0] * 5 + [PI / 2, -PI / 2, PI, PI, PI / 2, -PI]


def test_direction_to_infinity_and_of_what_is_not_a_number() -> None:
    (found,) = mapped(atan2_of, [1.0, np.inf, -np.inf, 1.0], [np.inf, 1.0, 1.0, -np.inf])
    assert found.tolist() == [0.0, PI / 2, -PI / 2, PI]
    (found,) = mapped(atan2_of, [np.nan, np.nan, 1.0, 0.0, np.inf, np.inf], [1.0, 0.0, np.nan, np.nan, np.nan, -np.inf])
    assert np.isnan(found).all()


@pytest.mark.parametrize("largest", [7.0, 100.0, 8000.0])
def test_wrapped_angles_point_the_same_way_within_a_turn(largest: float) -> None:
    angles = spread(-largest, largest)
    (found,) = mapped(wrap_of, angles)
    turns = (found.astype(float) - angles) / (2.0 * np.pi)
    assert np.abs(turns - np.rint(turns)).max() * 2.0 * np.pi < 3.2 * 2.0**-24
    assert np.abs(found.astype(float)).max() < np.pi + 1e-7 * largest


def test_wrapping_changes_no_angle_within_a_turn() -> None:
    angles = np.concatenate((spread(-np.pi, np.pi), [0.0, PI, -PI, np.nextafter(PI, np.float32(0.0)), 1e-45]))
    (found,) = mapped(wrap_of, angles)
    assert np.array_equal(found, angles.astype(np.float32))


def test_neither_sine_nor_wrapping_hides_what_is_not_finite() -> None:
    angles = [np.inf, -np.inf, np.nan]
    assert np.isnan(mapped(sincos_of, angles, outputs=2)).all()
    assert np.isnan(mapped(wrap_of, angles)).all()


def test_a_result_does_not_depend_on_its_neighbours() -> None:
    """Full vectors and what is left over behind them must compute the same bits."""
    values = spread(-50.0, 50.0, 1000)
    whole = [*mapped(sincos_of, values, outputs=2), *mapped(exp_of, values), *mapped(wrap_of, values)]
    single = [mapped(sincos_of, values[i : i + 1], outputs=2) for i in range(1000)]
    assert np.array_equal(whole[0], np.concatenate([sine for sine, _ in single]))
    assert np.array_equal(whole[1], np.concatenate([cosine for _, cosine in single]))
    for function, found in ((exp_of, whole[2]), (wrap_of, whole[3])):
        assert np.array_equal(found, np.concatenate([mapped(function, values[i : i + 1])[0] for i in range(1000)]))
    (directions,) = mapped(atan2_of, values, values[::-1])
    alone = [mapped(atan2_of, values[i : i + 1], values[::-1][i : i + 1])[0] for i in range(1000)]
    assert np.array_equal(directions, np.concatenate(alone))
