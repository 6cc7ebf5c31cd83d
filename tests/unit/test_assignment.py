"""The cheapest assignment: against another's, and exchanges against all permutations."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from dynpf.assignment import assign, cheapest_exchanges
from dynpf.rng import generator


@settings(deadline=None)
@given(rows=st.integers(1, 9), more=st.integers(0, 4), seed=st.integers(0, 10**6), whole=st.booleans())
def test_is_as_cheap_as_scipys(rows, more, seed, whole):
    costs = generator(seed, "costs", 0).standard_normal((rows, rows + more))
    costs = np.round(3.0 * costs) if whole else costs
    chosen = assign(costs)
    assert len(set(chosen.tolist())) == rows
    cheapest = costs[linear_sum_assignment(costs)].sum()
    assert costs[np.arange(rows), chosen].sum() == pytest.approx(cheapest, abs=1e-9)


def test_takes_no_impossible_pair_and_says_when_there_is_no_other():
    impossible = np.inf
    assert assign(np.array([[1.0, 0.0], [impossible, 5.0]])).tolist() == [0, 1]
    with pytest.raises(ValueError, match="no assignment of 2 rows to 2 columns"):
        assign(np.array([[impossible, 0.0], [impossible, 5.0]]))


@settings(deadline=None)
@given(seed=st.integers(0, 10**6))
def test_an_exchange_costs_what_the_cheapest_permutation_with_it_does(seed):
    count = 4
    costs = generator(seed, "costs", 0).standard_normal((count, count))
    costs = costs[:, assign(costs)]  # now the identity is the cheapest
    rows = np.arange(count)
    totals = {order: costs[rows, order].sum() for order in itertools.permutations(range(count))}
    expected = [
        [min(total for order, total in totals.items() if order[row] == column) for column in rows] for row in rows
    ]
    np.testing.assert_allclose(cheapest_exchanges(costs), np.array(expected) - np.trace(costs), atol=1e-9)
