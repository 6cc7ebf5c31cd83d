"""Gated association: what all objects pay together is the least."""

import numpy as np

from dynpf.filters.association import associate

OUT = np.inf


def test_objects_do_not_take_what_another_needs_more():
    """Taken one after the other, the cheapest pair first, it would be [1, 0, 2]."""
    costs = np.array([[1.0, 1.5, OUT], [0.5, 2.0, 9.0], [OUT, OUT, 3.0]])
    assert associate(costs).tolist() == [1, 0, 2]
    costs[0, 1] = 5.0
    assert associate(costs).tolist() == [0, 1, 2]


def test_what_lies_outside_every_gate_is_nobodys():
    assert associate(np.array([[OUT, 1.0], [OUT, OUT]])).tolist() == [1, -1]


def test_an_object_goes_without_rather_than_pay_more_than_a_miss_costs():
    """The neighbour's measurement would be had only if the neighbour took what is none."""
    costs = np.array([[4.0, OUT], [-6.0, 3.0]])
    assert associate(costs, missed=0.0).tolist() == [-1, 0]
    assert associate(costs).tolist() == [0, 1]


def test_no_measurements_and_no_objects():
    assert associate(np.empty((2, 0))).tolist() == [-1, -1]
    assert associate(np.empty((0, 2))).tolist() == []
