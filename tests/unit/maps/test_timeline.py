"""Which of several maps holds when."""

import math

import pytest

from dynpf.maps import MapTimeline


def test_a_map_holds_from_its_start_until_the_next() -> None:
    timeline = MapTimeline(((0.0, "a"), (5.0, "b"), (9.0, "c")))
    assert [timeline.at(time) for time in (0.0, 4.999, 5.0, 8.0, 9.0, math.inf)] == ["a", "a", "b", "b", "c", "c"]
    assert timeline.changes == (5.0, 9.0)


def test_the_first_map_holds_before_its_start_too() -> None:
    timeline = MapTimeline(((3.0, "a"),))
    assert timeline.at(-1.0) == "a"
    assert timeline.changes == ()


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ([], "a timeline without maps"),
        ([0.0, 2.0, 2.0], "map 2 starts at 2.0; expected a time after 2.0"),
        ([1.0, 0.0], "map 1 starts at 0.0; expected a time after 1.0"),
        ([0.0, math.nan], "map 1 starts at nan; expected a finite time"),
    ],
)
def test_starts_must_ascend(starts: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MapTimeline(tuple((start, "map") for start in starts))


def test_a_time_that_is_no_number_has_no_map() -> None:
    with pytest.raises(ValueError, match="time = nan; expected seconds"):
        MapTimeline(((0.0, "a"),)).at(math.nan)
