"""The distance field, against its definition and against OpenCV."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from dynpf.maps.distance import FAR, distance_field, squared_distances
from dynpf.reference import distance as reference
from dynpf.rng import generator

SHAPES = array_shapes(min_dims=2, max_dims=2, max_side=12)


@settings(deadline=None)  # the first call compiles
@given(arrays(np.bool_, SHAPES, elements=st.booleans(), fill=st.just(False)))
def test_the_kernel_finds_the_exact_squares(occupied: NDArray[np.bool_]) -> None:
    squared = squared_distances(occupied)
    assert squared.dtype == np.int32
    assert np.array_equal(squared, reference.squared_distances(occupied, FAR))


def test_a_large_map_has_the_distances_of_opencv() -> None:
    occupied = generator(1, "test", 0).random((700, 1000)) < 0.0005
    oracle = cv2.distanceTransform((~occupied).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    assert np.allclose(distance_field(occupied, 1.0), oracle, rtol=1e-6, atol=0)


def test_a_single_wall_is_seen_from_everywhere() -> None:
    occupied = np.zeros((30, 40), dtype=bool)
    occupied[7, 11] = True
    row, column = np.indices(occupied.shape)
    assert np.allclose(distance_field(occupied, 0.05), 0.05 * np.hypot(row - 7, column - 11), rtol=1e-7)


def test_distances_end_at_the_greatest_that_is_asked_for() -> None:
    occupied = np.eye(1, 10, dtype=bool)
    assert distance_field(occupied, 0.5, 2.0).tolist() == [[0.0, 0.5, 1.0, 1.5, *([2.0] * 6)]]


def test_without_a_wall_every_distance_is_the_greatest() -> None:
    empty = np.zeros((2, 3), dtype=bool)
    assert (squared_distances(empty) == FAR).all()
    assert (distance_field(empty, 0.05) == math.inf).all()
    assert (distance_field(empty, 0.05, 2.0) == 2.0).all()


def test_a_reversed_view_of_an_array_is_read_as_it_shows() -> None:
    occupied = np.eye(3, 5, dtype=bool)
    assert np.array_equal(squared_distances(occupied[::-1]), squared_distances(occupied)[::-1])


@pytest.mark.parametrize("greatest", [0.0, -1.0, math.nan])
def test_a_greatest_distance_is_above_zero(greatest: float) -> None:
    with pytest.raises(ValueError, match=f"max_distance = {greatest}; expected metres, above 0"):
        distance_field(np.eye(2, dtype=bool), 1.0, greatest)


def test_squares_that_would_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="46341 x 1 cells; expected sides whose squares"):
        squared_distances(np.zeros((1, 46341), dtype=bool))
