"""What is no number, or too large for one, leads no kernel out of its arrays, nor to what a processor makes of it."""

from typing import Any

import numpy as np
import pytest

from dynpf import kernels
from dynpf.kernels import elementary, elementary64
from dynpf.kernels.compiler import kernel
from dynpf.types import Float32s, Int32s

_sincos, _exp, _whole, _sincos64, _exp64 = (
    *(elementary.sincos, elementary.exp, elementary.whole),
    *(elementary64.sincos, elementary64.exp),
)
STRANGE = [np.nan, np.inf, -np.inf, 1e30, -1e30, 3e9]


@kernel
def _wholes(numbers: Float32s, out: Int32s) -> None:
    for i in range(numbers.size):
        out[i] = _whole(numbers[i])


@kernel
def _functions(number: np.float32, number64: float) -> Any:
    return _sincos(number), _exp(number), _sincos64(number64), _exp64(number64)


def test_a_whole_number_in_float32_is_read_exactly_up_to_four_millions() -> None:
    numbers = np.concatenate([np.arange(-(2**22) + 1, -(2**22) + 99), np.arange(-99, 99), np.arange(2**22 - 99, 2**22)])
    out = np.empty(numbers.size, dtype=np.int32)
    _wholes(numbers.astype(np.float32), out)
    np.testing.assert_array_equal(out, numbers)


def test_what_is_too_large_is_read_from_the_bits_of_a_sum_and_not_as_a_processor_casts_it() -> None:
    numbers = np.array([3e9, -1e30, np.inf], dtype=np.float32)
    out = np.empty(3, dtype=np.int32)
    _wholes(numbers, out)
    sums = (numbers + np.float32(1.5 * 2**23)).view(np.int32)
    np.testing.assert_array_equal(out, (sums.astype(np.int64) - 0x4B400000 + 2**31) % 2**32 - 2**31)


def test_functions_of_what_is_no_number_are_none() -> None:
    for value in (np.nan, np.inf, -np.inf):
        sincos, _, sincos64, _ = _functions(np.float32(value), value)
        assert np.isnan([*sincos, *sincos64]).all()
    assert np.isnan(_functions(np.float32(np.nan), np.nan)[1::2]).all()


@pytest.mark.parametrize("strange", STRANGE)
def test_a_potential_is_infinite_or_none_where_a_pose_is_no_number(strange: float) -> None:
    ratios = np.ones((5, 4, 3), dtype=np.float32)
    frame = np.array([0.0, 0.0, 1.0, 3 / (2 * np.pi), 1.0, 1.0, 0.1], dtype=np.float32)
    for axis in range(3):
        pose = np.ones((3, 1), dtype=np.float32)
        pose[axis] = strange
        out = np.zeros(1, dtype=np.float32)
        kernels.fields.interpolate(ratios, frame, *pose, out)
        far = axis < 2 or not np.isfinite(strange)
        assert not np.isfinite(out[0]) or out[0] > 1e8 if far else np.isfinite(out[0])


@pytest.mark.parametrize("strange", STRANGE)
def test_an_image_has_a_value_of_its_own_at_a_place_that_is_none(strange: float) -> None:
    image = np.arange(20.0, dtype=np.float32).reshape(4, 5)
    out = np.full(2, -1.0)
    kernels.edges.inner_contrasts(image, np.array([[strange, 1.0, 1.0], [1.0, strange, 1.0]]), np.zeros((1, 2)), out)
    assert ((out >= 0.0) & (out < 20.0)).all()


@pytest.mark.parametrize("strange", STRANGE)
def test_a_ray_from_nowhere_or_along_nothing_reaches_as_far_as_any(strange: float) -> None:
    tables = np.full((8, 200), 127, dtype=np.uint8)
    tables[:, -1] = 0
    frame = np.array([0.0, 0.0, 0.0, 1.0], dtype=np.float32)
    for axis in range(2):
        ray = np.ones((3, 1), dtype=np.float32)
        ray[axis] = strange
        out = np.zeros(1, dtype=np.float32)
        kernels.rays.cast(*ray, tables, np.array([10, 12]), frame, 5.0, out)
        assert out[0] == 5.0


def test_a_comb_through_weights_that_are_not_all_positive_stays_within_the_particles() -> None:
    weights = np.array([1e300, -1e300, 1e-300, 0.0])
    chosen = np.full(4, -1, dtype=np.int32)
    assert kernels.cloud.systematic(weights, 0.5, chosen)
    assert ((chosen >= 0) & (chosen < 4)).all()


def test_a_colour_in_too_bright_a_light_is_white() -> None:
    frame = np.zeros((3, 3, 3), dtype=np.uint8)
    place, light = np.zeros((3, 3), dtype=np.float32), np.full((3, 3), 1.5, dtype=np.float32)
    edge = np.float32(1.0), np.float32(1.0), np.array([1.0, 0.5, 0.0], dtype=np.float32)
    disc, colour = np.array([0.0, 0.0, 9.0], dtype=np.float32), np.array([250.0, 100.0, 0.0], dtype=np.float32)
    kernels.drawing.draw_disc(frame, place, place, light, (0, 3, 0, 3), disc, np.float32(1.0), edge, colour)
    assert frame[1, 1].tolist() == [255, 150, 0]
