"""What is said of a run: by its health, by its walls, and by its reference."""

import math

import numpy as np
import pytest
from dynpf_systems.rooms.verdict import Fit, Span, verdict_of
from dynpf_systems.rooms.wall_fit import WallFit

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.scan import Scan

GOOD = Fit(0.9, math.nan, 0.2)
TRACKING = Span("tracking", 0.0, 90.0, "")
LOST = Span("lost", 90.0, 100.0, "no particle explains the last 5 updates")


def test_shares_are_of_the_time_and_losses_on_the_way_are_named() -> None:
    verdict = verdict_of(
        [LOST._replace(start_s=0.0, end_s=10.0), TRACKING._replace(start_s=10.0, end_s=100.0)], 0.0, GOOD
    )
    assert verdict.localized
    assert verdict.text == "localized: 90 % of the time tracking, 10 % lost; lost from 0.0 to 10.0 s"
    assert verdict.shares == {"tracking": pytest.approx(0.9), "lost": pytest.approx(0.1)}


def test_a_run_that_ends_lost_is_lost_from_when_it_left_its_track() -> None:
    unsure = Span("uncertain", 95.0, 97.0, "position spread")
    ends = [TRACKING, LOST._replace(end_s=95.0), unsure, LOST._replace(start_s=97.0)]
    verdict = verdict_of(ends, 0.0, GOOD)
    assert not verdict.localized
    assert verdict.text.startswith("lost from 90.0 s on, to the end: no particle explains the last 5 updates")


@pytest.mark.parametrize(
    ("wrong", "fit", "told"),
    [
        (0.06, GOOD, "in 6 % of the time it says tracking, more than 1 m from the reference"),
        (0.0, Fit(0.3, math.nan, 0.2), "30 % of the beams end near a wall at its estimates, 20 % would anywhere"),
    ],
)
def test_tracking_is_not_believed_against_reference_or_walls(wrong: float, fit: Fit, told: str) -> None:
    verdict = verdict_of([TRACKING], wrong, fit)
    assert not verdict.localized
    assert told in verdict.text
    assert verdict_of([TRACKING], 0.04, Fit(0.36, math.nan, 0.2)).localized  # within both limits


def test_without_an_estimate_nothing_is_localized() -> None:
    assert verdict_of([], 0.0, Fit()).text == "not localized: there is no estimate"


def test_beams_near_walls_are_counted_where_the_scanner_is() -> None:
    """A room of 4 m by 4 m: from its middle four beams end at walls; 1 m aside two of them do, along the other axis."""
    occupied = np.zeros((50, 50), dtype=bool)
    occupied[[4, 45], 4:46] = occupied[4:46, [4, 45]] = True
    walls = WallFit(OccupancyGrid.from_bools(occupied, 0.1))
    angles = np.array([0.0, np.pi / 2, np.pi, -np.pi / 2, 0.3], dtype=np.float32)
    ranges = np.array([2.05, 2.05, 2.05, 2.05, 9.0], dtype=np.float32)  # the last has no return, and does not count
    scan = Scan(angles, ranges, 0.0, 9.0, mount=(0.5, 0.0, 0.0))
    middle = np.array([[2.0], [2.5], [0.0]])  # the scanner is half a metre ahead
    assert walls.share([scan], middle) == 1.0
    assert walls.share([scan], middle + np.array([[0.0], [1.0], [0.0]])) == 0.5
    assert walls.share([scan], middle + 100.0) == 0.0
