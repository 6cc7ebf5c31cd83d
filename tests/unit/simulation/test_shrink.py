"""Shrinking keeps what fails, and nothing that it can do without."""

from collections.abc import Sequence

from dynpf_runtime.simulation.shrink import shrunk
from hypothesis import given
from hypothesis import strategies as st


@given(st.integers(0, 30).flatmap(lambda count: st.tuples(st.just(count), st.sets(st.integers(0, max(count - 1, 0))))))
def test_what_alone_makes_it_fail_is_found_in_its_order(drawn: tuple[int, set[int]]) -> None:
    count, needed = drawn[0], drawn[1] if drawn[0] else set()
    assert shrunk(range(count), lambda items: needed <= {*items}) == tuple(sorted(needed))


def test_of_several_causes_one_is_left() -> None:
    def fails(items: Sequence[int]) -> bool:
        return {1, 7} <= {*items} or {3} <= {*items}

    assert shrunk(range(10), fails) in ((3,), (1, 7))


def test_what_fails_without_anything_is_shrunk_to_nothing() -> None:
    assert shrunk(range(10), lambda _: True) == ()
