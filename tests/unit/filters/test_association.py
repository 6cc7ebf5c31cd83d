"""Gated nearest-neighbour association."""

import numpy as np

from dynpf.filters.association import associate

OUT = np.inf


def test_each_object_takes_its_cheapest_measurement_that_is_still_free():
    costs = np.array([[1.0, 5.0, OUT], [0.5, 2.0, 9.0], [OUT, OUT, 3.0]])
    assert associate(costs).tolist() == [1, 0, 2]


def test_what_lies_outside_every_gate_is_nobodys():
    assert associate(np.array([[OUT, 1.0], [OUT, OUT]])).tolist() == [1, -1]


def test_no_measurements_and_no_objects():
    assert associate(np.empty((2, 0))).tolist() == [-1, -1]
    assert associate(np.empty((0, 2))).tolist() == []
