"""Measures of a capsule's run: closed forms, and what does not apply is NaN."""

import math

import numpy as np
import pytest

from dynpf.colon.hypotheses import UNLISTED
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.metrics.colon import capsule_errors, first_visible, map_errors


def test_errors_are_percentages_of_the_true_coordinates() -> None:
    found = capsule_errors(np.array([800.0, 400.0, 2.0]), np.array([808.0, 394.0, 2.1]))
    assert found == pytest.approx(
        {
            "error_x_percent": 1.0,
            "error_y_percent": 1.5,
            "error_theta_percent": 5.0,
            "error_position_px": 10.0,
            "error_theta_rad": 0.1,
            "lost": False,
        }
    )


def test_a_heading_is_compared_the_short_way_round_and_of_nothing_there_is_no_percentage() -> None:
    found = capsule_errors(np.array([0.0, 100.0, math.pi]), np.array([31.0, 100.0, -math.pi + 0.2]))
    assert found["error_theta_rad"] == pytest.approx(0.2)
    assert math.isnan(found["error_x_percent"])
    assert found["lost"] is True


A, B, U = {"a": 0.9, "b": 0.1}, {"a": 0.2, "b": 0.8}, {"a": 0.3, "b": 0.0, UNLISTED: 0.7}


@pytest.mark.parametrize(
    ("true", "found", "visible", "expected"),
    [
        ("aaaa", [A, A, A, A], None, (0.9, False, math.nan, math.nan)),
        ("aaaa", [A, U, A, A], None, (0.9, True, math.nan, math.nan)),
        ("abbb", [A, A, B, B], 1, (0.8, math.nan, False, 1.0)),
        ("abbb", [A, A, A, A], 1, (0.1, math.nan, True, math.nan)),
        ("abbb", [A, A, A, A], None, (0.1, math.nan, math.nan, math.nan)),
        ("accc", [A, A, A, U], 2, (0.7, math.nan, False, 1.0)),
        ("abbb", [B, A, A, A], 1, (0.1, math.nan, True, math.nan)),  # what was reported too early is no report
    ],
)
def test_what_a_posterior_over_maps_is_worth(
    true: str, found: list[dict[str, float]], visible: int | None, expected: tuple[float, ...]
) -> None:
    measures = map_errors(true, found, visible)
    names = ("posterior_truth", "false_alarm", "missed", "delay_steps")
    np.testing.assert_equal(tuple(measures[name] for name in names), expected)


def test_a_change_can_be_seen_where_a_range_differs_by_more_than_ten_pixels() -> None:
    casters = {}
    for name, wall in (("a", 50), ("b", 55), ("c", 65)):
        occupied = np.ones((40, 100), dtype=bool)
        occupied[5:35, 5:wall] = False
        casters[name] = RayCaster(OccupancyGrid.from_bools(occupied, 1.0))
    poses = np.repeat(np.array([[20.0], [20.0], [0.0]]), 4, axis=1)
    assert first_visible("aacc", poses, casters.__getitem__) == 2
    assert first_visible("aabb", poses, casters.__getitem__) is None
    poses[2] = math.pi  # faces away from what has changed
    assert first_visible("aacc", poses, casters.__getitem__) is None
