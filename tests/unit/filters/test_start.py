"""Where particles come from."""

import math
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from dynpf.filters.models import Models
from dynpf.filters.start import (
    Box,
    FromReadings,
    FromReadingsStart,
    KnownStart,
    Start,
    Uniform,
    UniformStart,
    pose_source,
    start_poses,
)
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.rng import Stream
from dynpf.se2 import Floats

STREAM = Stream.of(1, "test", 0)
BOX = Box(x_min=-4.0, x_max=4.0, y_min=0.0, y_max=2.0)


class Place(NamedTuple):
    """A reading of x with a standard deviation of 0.5 m."""

    x: float


class Position:
    """Its model, and no more than a filter asks of one."""

    def admit(self, particles: Floats, weights: Floats, reading: Place) -> Place | None:  # noqa: ARG002
        assert weights.sum() == pytest.approx(1.0, rel=1e-5)
        return reading if math.isfinite(reading.x) else None

    def log_likelihood(self, particles: Floats, reading: Place) -> Floats:
        return np.asarray(-2.0 * (particles[0] - np.float32(reading.x)) ** 2)


class Nowhere(Position):
    def log_likelihood(self, particles: Floats, reading: Place) -> Floats:  # noqa: ARG002
        return np.full(particles.shape[1], -np.inf, dtype=np.float32)


class Ring(Position):
    """A model that knows from where it could have seen what it sees."""

    def poses(self, reading: Place, count: int, stream: Stream) -> Floats:
        poses = stream.normals(3, count)
        poses[0] += np.float32(reading.x)
        return poses


class Still:
    """A motion model for filters that do not move."""

    def particles(self, poses: Floats, stream: Stream) -> Floats:  # noqa: ARG002
        return poses

    def propagate(self, particles: Floats, control: object, stream: Stream) -> Floats:  # noqa: ARG002
        return particles


def models(model: Position) -> Models:
    return Models(Still(), {Place: model})


def test_known_starts_have_the_mean_and_spread_that_is_asked_for() -> None:
    start = KnownStart(x=1.0, y=-2.0, theta=3.0, sigma_position=0.5, sigma_heading=0.1)
    poses = start_poses(start, 40_000, STREAM)
    assert poses.dtype == np.float32
    assert poses.mean(axis=1) == pytest.approx([1.0, -2.0, 3.0], abs=0.01)
    assert poses.std(axis=1) == pytest.approx([0.5, 0.5, 0.1], rel=0.02)
    np.testing.assert_array_equal(start_poses(KnownStart(sigma_position=0.0, sigma_heading=0.0), 2, STREAM), 0.0)


def test_a_box_is_filled_evenly() -> None:
    poses = start_poses(UniformStart(box=BOX), 40_000, STREAM)
    for row, (low, high) in zip(poses, ((-4.0, 4.0), (0.0, 2.0), (-np.pi, np.pi)), strict=True):
        counts, _ = np.histogram(row, bins=20, range=(low, high))
        assert counts.sum() == 40_000
        # 2000 to a bin, with a standard deviation of 44.
        assert np.abs(counts - 2000).max() < 200


def test_free_space_is_filled_and_nothing_else() -> None:
    cells = np.ones((20, 30), dtype=bool)
    cells[5:9, 10:14] = False
    grid = OccupancyGrid.from_bools(cells, 0.1, (2.0, -1.0, 0.3))
    poses = start_poses(UniformStart(), 2000, STREAM, grid=grid)
    columns, rows = grid.to_cells(poses[0], poses[1])
    np.testing.assert_allclose(columns, 12.0, atol=2.0 + 1e-4)
    np.testing.assert_allclose(rows, 7.0, atol=2.0 + 1e-4)
    cleared = start_poses(UniformStart(clearance=0.09), 100, STREAM, grid=grid)
    np.testing.assert_allclose(grid.to_cells(cleared[0], cleared[1])[0], 12.0, atol=1.0 + 1e-4)


def test_a_heading_that_is_known_is_kept_at_any_position() -> None:
    poses = start_poses(UniformStart(box=BOX, theta=0.5), 10, STREAM)
    assert set(poses[2].tolist()) == {0.5}
    assert np.unique(poses[0]).size == 10


@pytest.mark.parametrize("model", [Position(), Ring()])
def test_poses_from_readings_lie_where_the_readings_are_likely(model: Position) -> None:
    start = FromReadingsStart(base=UniformStart(box=BOX))
    poses = start_poses(start, 4000, STREAM, models=models(model), readings=[Place(1.0)])
    assert poses.shape == (3, 4000)
    assert poses.dtype == np.float32
    assert poses[0].mean() == pytest.approx(1.0, abs=0.05)
    assert poses[1].min() >= BOX.y_min  # what a reading proposes is bounded, too; half of the ring is below
    assert poses[1].max() <= BOX.y_max
    # From the box the spread is the reading's; the ring of unit variance is narrowed by it: 1 / (1 + 4).
    expected = 0.5 if type(model) is Position else math.sqrt(0.2)
    assert poses[0].std() == pytest.approx(expected, rel=0.05)


def test_several_readings_are_weighed_together() -> None:
    start = FromReadingsStart(candidates=40, base=UniformStart(box=BOX))
    poses = start_poses(start, 1000, STREAM, models=models(Position()), readings=[Place(0.0), Place(1.0)])
    assert poses[0].mean() == pytest.approx(0.5, abs=0.05)
    assert poses[0].std() == pytest.approx(0.5 / math.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize(
    ("model", "readings"), [(Position(), []), (Position(), [Place(math.nan)]), (Nowhere(), [Place(0.0)])]
)
def test_readings_that_tell_nothing_leave_poses_spread_over_the_base(model: Position, readings: list[Place]) -> None:
    start = FromReadingsStart(base=UniformStart(box=BOX))
    poses = start_poses(start, 2000, STREAM, models=models(model), readings=readings)
    assert poses.shape == (3, 2000)
    assert poses[0].std() == pytest.approx(8.0 / math.sqrt(12.0), rel=0.05)


def test_a_reading_that_no_model_takes_is_refused() -> None:
    source = FromReadings(FromReadingsStart(), models(Position()), Uniform(UniformStart(box=BOX)))
    with pytest.raises(TypeError, match="float"):
        source.draw(5, [1.0], STREAM)


def test_starts_that_lack_what_they_draw_from_are_refused() -> None:
    with pytest.raises(ValueError, match="neither"):
        pose_source(UniformStart())
    with pytest.raises(ValueError, match="models"):
        pose_source(FromReadingsStart(base=UniformStart(box=BOX)))
    with pytest.raises(ValueError, match="minimum"):
        Box(x_min=1.0, x_max=0.0, y_min=0.0, y_max=1.0)


def test_the_kind_of_a_table_chooses_the_start() -> None:
    table = {"kind": "from_readings", "candidates": 5, "base": {"kind": "uniform", "theta": 0.0}}
    assert msgspec.convert(table, Start) == FromReadingsStart(candidates=5, base=UniformStart(theta=0.0))
    assert msgspec.convert({"kind": "known", "x": 1.0}, Start) == KnownStart(x=1.0)
