"""The lookup of many landmarks at once."""

import numpy as np
import pytest

from dynpf.maps import LandmarkMap


def test_ids_are_found_in_any_order_and_shape() -> None:
    landmarks = LandmarkMap([(17, 5.0, 6.0), (6, 1.0, 2.0), (13, 3.0, 4.0)])
    columns = landmarks.columns([[13, 6], [17, 13]])
    assert columns.dtype == np.int32
    assert columns.tolist() == [[1, 0], [2, 1]]
    assert landmarks.rows.dtype == np.float32
    assert landmarks.rows[:, columns[1]].tolist() == [[5.0, 3.0], [6.0, 4.0]]


@pytest.mark.parametrize("unknown", [5, 7, 18, -1])
def test_an_unknown_id_has_no_column(unknown: int) -> None:
    landmarks = LandmarkMap([(6, 1.0, 2.0), (17, 5.0, 6.0)])
    assert landmarks.columns([unknown, 17]).tolist() == [-1, 1]


def test_a_map_without_landmarks_knows_none() -> None:
    assert LandmarkMap([]).columns([6, 7]).tolist() == [-1, -1]
    assert LandmarkMap([]).columns([]).tolist() == []
