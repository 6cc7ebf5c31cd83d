"""The search of ``dynpf why``, on made-up runs of which it is known when failure became inevitable, and by what."""

from collections.abc import Callable, Sequence

import pytest
from dynpf_experiments.why.causes import Event, Stretch, Way
from dynpf_experiments.why.futures import Future
from dynpf_experiments.why.search import WIDEST, Interval, Reasons, Search, Task
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.rng import generator

FAILED = 400
WAYS = (Way("sensors/odometry", "input", ("estimator",)), Way("controller/command", "decision", ("simulator",)))
EVENTS = (Event("simulator", "kidnappings", 0, 90), Event("simulator", "kidnappings", 1, 310))
BUDGET = 200


def found(
    fails: Callable[[Future, float], bool], events: Sequence[Event] = EVENTS, budget: int = BUDGET, seed: int = 1
) -> Reasons:
    """Return what is found where ``fails`` says whether a future fails, by a uniform number of the future's own."""

    def ask(futures: Sequence[Future]) -> list[bool]:
        numbers = [1.0 if one.seed is None else generator(one.seed, one.node, one.tick).random() for one in futures]
        return [fails(future, number) for future, number in zip(futures, numbers, strict=True)]

    task = Task(FAILED, ("simulator", "estimator"), events, WAYS)
    return Search(task, ask, budget=budget, seed=seed, show=lambda _: None).run()


@given(true=st.integers(1, FAILED), seed=st.integers(0, 10**6), share=st.sampled_from([0.0, 0.1, 0.3]))
@settings(max_examples=60, deadline=None)
def test_the_tick_in_which_chance_decided_is_in_the_interval(true: int, seed: int, share: float) -> None:
    reasons = found(lambda future, number: future.tick > true or number > 1.0 - share, seed=seed)
    assert reasons.chance is not None
    assert reasons.chance.first <= true <= reasons.chance.last
    assert reasons.chance.width <= WIDEST
    assert reasons.futures <= BUDGET
    assert not reasons.exhausted


def test_the_node_is_told_whose_random_numbers_decided() -> None:
    reasons = found(lambda future, _: future.tick > 123 or future.node == "simulator")
    assert dict(reasons.by_node)["simulator"].failed == dict(reasons.by_node)["simulator"].trials
    assert dict(reasons.by_node)["estimator"].failed == 0


def test_an_event_is_named_that_averts_the_failure_whatever_chance_does() -> None:
    reasons = found(lambda future, _: not (future.cause == EVENTS[1] and future.tick <= EVENTS[1].tick))
    assert reasons.chance is None
    assert [(named.cause, named.interval) for named in reasons.causes] == [(EVENTS[1], Interval(310, 310))]
    assert reasons.interval == Interval(310, 310)


@given(first=st.integers(1, 390), length=st.integers(1, 9), way=st.sampled_from(WAYS))
@settings(max_examples=60, deadline=None)
def test_the_shortest_stretch_is_named_that_averts_the_failure(first: int, length: int, way: Way) -> None:
    last = min(first + length - 1, FAILED)

    def fails(future: Future, _: float) -> bool:
        cause = future.cause
        return not (
            isinstance(cause, Stretch)
            and cause.way == way
            and future.tick <= cause.first <= first
            and last <= cause.last
        )

    reasons = found(fails)
    assert [named.cause for named in reasons.causes[:1]] == [Stretch(way, first, last)]
    assert reasons.interval == Interval(first, last)
    assert reasons.futures <= BUDGET


def test_what_averts_no_more_often_than_chance_is_not_named() -> None:
    def fails(future: Future, number: float) -> bool:
        return number > 0.3 if future.cause is None else False if future.seed is None else number > 0.3

    assert found(fails).causes == ()


def test_nothing_is_named_where_nothing_averts_the_failure() -> None:
    reasons = found(lambda *_: True)
    assert reasons.interval is None
    assert not reasons.exhausted


@pytest.mark.parametrize("budget", [1, 10, 30])
def test_a_budget_is_kept_and_its_end_is_told(budget: int) -> None:
    asked = []

    def fails(future: Future, _: float) -> bool:
        asked.append(future)
        return future.tick > 200

    reasons = found(fails, budget=budget)
    assert reasons.exhausted
    assert len(asked) == reasons.futures <= budget
