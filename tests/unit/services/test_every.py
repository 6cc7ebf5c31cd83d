"""At most every so often: due at first, then once a period, whatever the steps between; a user's node has it, too."""

from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import pytest
from dynpf_lab import Every, Message, Moment, Node
from hypothesis import given
from hypothesis import strategies as st


def said(every: Every, stamps: list[int]) -> list[int]:
    last: int | None = None
    found = []
    for stamp in stamps:
        if every.due(stamp, last):
            last = stamp
            found.append(stamp)
    return found


@given(st.lists(st.integers(0, 10**11), min_size=1).map(sorted), st.floats(0.01, 100.0))
def test_it_is_said_at_first_and_then_as_soon_as_a_period_is_over(stamps: list[int], period_s: float) -> None:
    period_ns = round(period_s * 1e9)
    found = said(Every(period_s), stamps)
    assert found[0] == stamps[0]
    for one, other in pairwise(found):
        assert other == min(stamp for stamp in stamps if stamp >= one + period_ns)
    assert max(stamps) - found[-1] < period_ns


def test_a_period_of_zero_is_always_due() -> None:
    assert said(Every(0.0), [3, 3, 4]) == [3, 3, 4]


@pytest.mark.parametrize(("stamp_ns", "due"), [(199_999_999, False), (200_000_000, True)])
def test_a_period_ends_on_its_last_nanosecond(stamp_ns: int, due: bool) -> None:
    assert Every(0.2).due(stamp_ns, 0) is due


class Alarm(Message, frozen=True, kw_only=True):
    schema_name = "guarding.Alarm"


class Guard(Node, frozen=True, kw_only=True):
    every: Every = Every(0.2)

    class State(NamedTuple):
        said_ns: int | None = None

    def step(self, state: Any, moment: Moment) -> Any:
        if not self.every.due(moment.stamp_ns, state.said_ns):
            return state, ()
        return state._replace(said_ns=moment.stamp_ns), (Alarm(),)


@pytest.mark.parametrize(("table", "count"), [({}, 3), ({"every": {"period_s": 0.3}}, 2)])
def test_a_node_of_ones_own_has_the_period_as_a_parameter_and_the_stamp_in_its_state(
    table: dict[str, Any], count: int
) -> None:
    guard, state, alarms = msgspec.convert(table, Guard), Guard.State(), 0
    for number in range(6):
        moment = Moment(number, number, number * 10**8, (), node="guard", seed=1, fact=lambda _: None)
        state, said = guard.step(state, moment)
        alarms += len(said)
    assert alarms == count
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"every": {"period_s": -1.0}}, Guard)
