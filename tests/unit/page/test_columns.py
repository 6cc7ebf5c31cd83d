"""Packed numbers: what is unpacked is what was packed, to within a step, and no peak is lost."""

import base64

import numpy as np
from dynpf_experiments.pictures.columns import LARGEST, column, evenly, extremes, points, runs
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

VALUES = arrays(np.float64, st.integers(0, 30), elements=st.floats(allow_nan=True, allow_infinity=True))


@settings(deadline=None)
@given(VALUES)
def test_a_column_gives_its_numbers_back(values: np.ndarray) -> None:
    packed = column(values, 0.25)
    steps = 0
    for value, difference in zip(values.tolist(), packed["d"], strict=True):
        if difference is None:
            assert not abs(value) <= LARGEST
        else:
            steps += difference
            assert abs(steps * packed["q"] - value) <= 0.125 + 1e-6 * abs(value)


@settings(deadline=None)
@given(st.lists(arrays(np.float64, st.tuples(st.just(2), st.integers(0, 6)), elements=st.floats(-1e4, 1e4))))
def test_points_are_where_they_were(clouds: list[np.ndarray]) -> None:
    packed = points(clouds)
    offsets = np.frombuffer(base64.b64decode(packed["b"]), "<i2").reshape(-1, 2)
    assert packed["n"] == [cloud.shape[1] for cloud in clouds]
    begin, middle = 0, np.zeros(2)
    for number, cloud in enumerate(clouds):
        middle = middle + np.array([packed["x"]["d"][number], packed["y"]["d"][number]])
        found = packed["x"]["q"] * middle[:, None] + packed["q"] * offsets[begin : begin + cloud.shape[1]].T
        begin += cloud.shape[1]
        assert np.all(np.abs(found - cloud) <= 0.5 * packed["q"] + 0.5 * packed["x"]["q"] + 1e-9)


def test_points_that_are_no_numbers_are_left_out() -> None:
    assert points([np.array([[0.0, np.nan, np.inf, 1e300], [0.0, 0.0, 0.0, 0.0]])])["n"] == [1]


@settings(deadline=None)
@given(arrays(np.float64, st.integers(0, 300), elements=st.floats(-1e6, 1e6)), st.integers(2, 40))
def test_the_greatest_and_the_least_value_stay(values: np.ndarray, most: int) -> None:
    chosen = extremes(values, most)
    assert chosen.size <= max(most, 2)
    assert values.size == 0 or (values[chosen].max(), values[chosen].min()) == (values.max(), values.min())


@settings(deadline=None)
@given(st.integers(0, 5000), st.integers(2, 60))
def test_even_distances_have_both_ends(count: int, most: int) -> None:
    chosen = evenly(count, most).tolist()
    assert len(chosen) == min(count, most)
    assert sorted(set(chosen)) == chosen
    assert not count or (chosen[0], chosen[-1]) == (0, count - 1)


@settings(deadline=None)
@given(arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 2)))
def test_cells_come_back_from_their_runs(cells: np.ndarray) -> None:
    flat = [run & 3 for run in runs(cells) for _ in range(run >> 2)]
    assert flat == cells.reshape(-1).tolist()
