"""The account of a publisher's numbers, against what sets of numbers say."""

from itertools import pairwise

from dynpf_formats.capture.series import MOST_RANGES, Series
from dynpf_formats.ros2.attachment import Lost
from hypothesis import given
from hypothesis import strategies as st

WRAP = 2**32
NUMBERS = st.lists(st.integers(1, 60), min_size=1, max_size=120)  # any of them lost, again and in any order


def numbers_of(lost: tuple[Lost, ...]) -> list[int]:
    return [number % WRAP for first, last in lost for number in range(first, last + 1)]


@given(NUMBERS, st.sets(st.integers(0, 119)), st.integers(0, WRAP - 1))
def test_lost_repeated_and_late_messages_are_those_of_the_sets_of_numbers(arrivals, dropped, offset):
    series = Series()
    for place, number in enumerate(arrivals):
        if place in dropped:
            series.drop(number + offset, number + offset, number)
        else:
            series.see(number + offset, number)
    came = set(arrivals)
    missing = set(range(min(came), max(came) + 1)) - came
    firsts = [number for place, number in enumerate(arrivals) if number not in arrivals[:place]]
    assert sorted(numbers_of(series.lost)) == sorted((number + offset) % WRAP for number in missing)
    assert series.missing == len(missing)
    assert series.duplicates == len(arrivals) - len(came)
    assert series.late == sum(number < max(firsts[: place + 1]) for place, number in enumerate(firsts))
    assert series.received + series.dropped == len(arrivals)
    assert series.dropped == sum(place in dropped for place in range(len(arrivals)))
    assert series.restarts == 0
    assert all(one.last + 1 < other.first for one, other in pairwise(series.lost))


@given(st.lists(st.tuples(st.integers(1, 60), st.integers(0, 8)), min_size=1, max_size=40))
def test_messages_dropped_together_count_as_if_dropped_one_by_one(ranges):
    together, alone = Series(), Series()
    for first, more in ranges:
        together.drop(first, first + more, 0)
        for number in range(first, first + more + 1):
            alone.drop(number, number, 0)
    for name in ("lost", "missing", "duplicates", "late", "dropped"):
        assert getattr(together, name) == getattr(alone, name), name


def test_a_gap_is_told_with_the_message_after_it():
    series = Series()
    assert [series.see(number, number) for number in (5, 6, 9)] == [None, None, Lost(7, 8)]


def test_who_counts_anew_has_lost_nothing():
    series = Series()
    for stamp_ns, number in enumerate([7, 8, 10, 1, 2, 4]):
        series.see(number, stamp_ns)
    assert (series.restarts, series.duplicates, series.late) == (1, 0, 0)
    assert series.lost == ((9, 9), (3, 3))


def test_memory_is_bounded_and_the_count_is_not():
    series = Series()
    for number in range(1, 20 * MOST_RANGES, 2):
        series.see(number, number)
    assert series.missing == 10 * MOST_RANGES - 1
    assert len(series.lost) == 2 * MOST_RANGES
