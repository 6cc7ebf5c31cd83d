"""A map contradicts beams that pass through its walls, not those that end early or where it knows nothing."""

import math

import numpy as np
import pytest

from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.scan import Scan

CELLS = np.full((40, 100), FREE, dtype=np.uint8)
CELLS[:, 60] = OCCUPIED  # a wall at x = 6 m
CELLS[:, 80:] = UNKNOWN
FIELD = LikelihoodField(LikelihoodFieldParams(), OccupancyGrid(CELLS, 0.1))


@pytest.mark.parametrize(
    ("x", "length", "contradicted"),
    [
        (2.0, 4.05, False),  # on the wall
        (2.0, 4.2, False),  # a little behind it
        (2.0, 4.9, True),  # through it
        (2.0, 10.0, True),  # without return, through it
        (2.0, 2.0, True),  # ends in free space
        (7.0, 2.0, False),  # ends where nothing is known
        (7.0, 10.0, False),  # without return, into what is not known
    ],
)
def test_a_beam_is_contradicted_by_what_is_known(x: float, length: float, contradicted: bool) -> None:
    scan = Scan(np.zeros(1, np.float32), np.array([length], np.float32), 0.0, 10.0)
    assert FIELD.contradicted(scan, np.array([x, 2.0, 0.0])) == float(contradicted)


def test_the_sensor_is_where_it_is_mounted() -> None:
    behind = Scan(np.zeros(1, np.float32), np.array([4.05], np.float32), 0.0, 10.0, mount=(-1.0, 0.0, 0.0))
    assert FIELD.contradicted(behind, np.array([3.0, 2.0, 0.0])) == 0.0
    turned = behind._replace(mount=(0.0, 0.0, math.pi))
    assert FIELD.contradicted(turned, np.array([3.0, 2.0, 0.0])) == 0.0  # off the map's other edge
    assert FIELD.contradicted(behind._replace(ranges=np.array([np.nan], np.float32)), np.zeros(3)) == 0.0
