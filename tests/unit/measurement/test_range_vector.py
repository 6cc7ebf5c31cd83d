"""A few ranges inside a closed tube: the source document's weight, the inside of a map, and what tells nothing."""

import math
from functools import partial

import msgspec
import numpy as np
import pytest

from dynpf.maps import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.measurement import RangeVector, RangeVectorModel, RangeVectorParams, range_vector
from dynpf.measurement.ray import ray_segments

# A room of 600 by 300 units inside walls one unit thick, which lies open to the right beyond a column of wall.
WIDTH, HEIGHT = 640, 302
OCCUPIED = np.zeros((HEIGHT, WIDTH), dtype=bool)
OCCUPIED[[0, -1]] = OCCUPIED[:, 0] = OCCUPIED[:, 601] = True
INNER = np.array([[1, 1, 601, 1], [601, 1, 601, 301], [601, 301, 1, 301], [1, 301, 1, 1]], dtype=np.float64)
ANGLES = np.radians([-60.0, -30.0, 0.0, 30.0, 60.0])
POSES = np.array([[100.0, 120.0, 100.0], [150.0, 150.0, 140.0], [0.0, 0.1, -0.1]], dtype=np.float32)


class Room:
    """Exact ranges inside the room, in place of the ray caster of grids; counts its rays."""

    def __init__(self, _grid: OccupancyGrid) -> None:
        self.rays = 0

    def ranges(self, x: np.ndarray, y: np.ndarray, angles: np.ndarray, range_max: float) -> np.ndarray:
        self.rays += x.size
        rays = zip(np.stack((x, y), axis=1), angles[:, None], strict=True)
        distances = [ray_segments(origin, angle, INNER)[0] for origin, angle in rays]
        nearest: np.ndarray = np.minimum(np.array(distances), range_max)
        return nearest.astype(np.float32)


@pytest.fixture(autouse=True)
def _exact_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(range_vector, "RayCaster", Room)


def model(origin: tuple[float, float, float] = (0.0, 0.0, 0.0), **params: object) -> RangeVectorModel:
    chosen = msgspec.structs.replace(RangeVectorParams(), **params)
    return RangeVectorModel(chosen, OccupancyGrid.from_bools(OCCUPIED, 1.0, origin))


def seen(pose: np.ndarray) -> RangeVector:
    return RangeVector(np.minimum(ray_segments(pose[:2], pose[2] + ANGLES, INNER), 500.0))


def test_the_log_weight_is_that_of_the_source_document() -> None:
    read = seen(POSES[:, 0])
    expected = [-0.5 * np.sum((seen(pose).ranges - read.ranges) ** 2) / 100.0**2 for pose in POSES.T]
    likelihood = model().log_likelihood(POSES, read)
    assert likelihood.dtype == np.float32
    assert likelihood == pytest.approx(expected, abs=1e-5)
    assert expected[0] == 0.0
    assert max(expected[1:]) < -1e-3


def test_rays_cast_in_the_grid_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    read = seen(POSES[:, 1])
    exact = model(sigma=10.0).log_likelihood(POSES, read)
    monkeypatch.setattr(range_vector, "RayCaster", RayCaster)
    assert model(sigma=10.0).log_likelihood(POSES, read) == pytest.approx(exact, abs=0.01)


def test_ranges_read_and_expected_are_capped() -> None:
    # The heading's beam would meet the wall at 501 of 601: both are taken for 500.
    read = seen(POSES[:, 0])
    for beyond in (501.0, 1e9, math.inf):
        reading = RangeVector(np.where(np.arange(5) == 2, beyond, read.ranges))
        assert model().log_likelihood(POSES, reading)[0] == pytest.approx(0.0, abs=1e-9)


def test_particles_off_the_map_in_its_walls_and_outside_the_tube_are_impossible_and_no_ray_is_cast_for_them() -> None:
    x = [100.0, 0.5, 601.5, 620.0, -1.0, 700.0, 100.0, 100.0, math.nan, math.inf, 1e30]
    y = [150.0, 150.0, 150.0, 150.0, 150.0, 150.0, -0.1, 302.5, 150.0, 150.0, 150.0]
    particles = np.array([x, y, np.zeros(11)])
    room = model()
    likelihood = room.log_likelihood(particles, seen(POSES[:, 0]))
    assert np.isneginf(likelihood).tolist() == [False] + [True] * 10
    caster: object = room._caster
    assert isinstance(caster, Room)
    assert caster.rays == 5


def test_inside_is_where_all_four_axis_directions_meet_a_wall() -> None:
    drawing = ["........", ".#####..", ".#...#..", ".#...#..", ".##.##..", "........"]
    occupied = np.array([[cell == "#" for cell in row] for row in drawing])
    # Brute force: for each cell, look along its row and its column. The gap below leaves one column open.
    expected = np.zeros_like(occupied)
    for row, column in np.ndindex(*occupied.shape):
        ways = (
            occupied[row, :column],
            occupied[row, column + 1 :],
            occupied[:row, column],
            occupied[row + 1 :, column],
        )
        expected[row, column] = not occupied[row, column] and all(way.any() for way in ways)
    assert np.array_equal(range_vector.closed_in(occupied), expected)
    assert np.argwhere(expected).tolist() == [[2, 2], [2, 4], [3, 2], [3, 4]]


def test_the_grid_s_origin_is_heeded() -> None:
    turned = model(origin=(10.0, 20.0, math.pi / 2))
    particles = np.array([[10.0 - 150.0, 100.0], [20.0 + 100.0, 150.0], [0.0, 0.0]])
    assert turned.inside(particles).tolist() == [True, False]
    assert model().inside(particles).tolist() == [False, True]


@pytest.mark.parametrize("useless", [math.nan, -1.0, -math.inf])
def test_a_beam_that_tells_nothing_is_left_out(useless: float) -> None:
    read = seen(POSES[:, 0]).ranges
    read[1] = useless
    kept = np.arange(5) != 1
    expected = [-0.5 * np.sum((seen(pose).ranges - read)[kept] ** 2) / 100.0**2 for pose in POSES.T]
    assert model().log_likelihood(POSES, RangeVector(read)) == pytest.approx(expected, abs=1e-5)
    assert model().admit(POSES, np.full(3, 1.0 / 3.0), RangeVector(read)) is not None


@pytest.mark.parametrize("ranges", [[math.nan] * 5, [-1.0] * 5, []])
def test_a_reading_of_no_other_beams_tells_nothing(ranges: list[float]) -> None:
    reading = RangeVector(np.array(ranges))
    assert model().admit(POSES, np.full(3, 1.0 / 3.0), reading) is None
    assert model().log_likelihood(POSES, reading).tolist() == [0.0, 0.0, 0.0]


def test_outliers_bound_how_much_one_beam_can_say_and_tempering_scales() -> None:
    read = seen(POSES[:, 0])
    wild = RangeVector(np.where(np.arange(5) == 2, 0.0, read.ranges))
    mixed = model(outlier_fraction=0.1, sigma=10.0, range_max=500.0)
    uniform = 0.1 * math.sqrt(2.0 * math.pi) * 10.0 / 500.0
    expected = 4.0 * math.log(0.9 + uniform) + math.log(uniform)
    assert mixed.log_likelihood(POSES[:, :1], wild) == pytest.approx([expected], rel=1e-5)
    tempered = model(outlier_fraction=0.1, sigma=10.0, tempering=0.5)
    assert tempered.log_likelihood(POSES[:, :1], wild) == pytest.approx([0.5 * expected], rel=1e-5)
    # The control: without outliers that beam alone is worth (500 / 10)^2 / 2.
    assert model(sigma=10.0).log_likelihood(POSES[:, :1], wild) == pytest.approx([-1250.0])


def test_the_likelihood_of_a_beam_integrates_to_the_gaussian_s_constant() -> None:
    params = RangeVectorParams(angles=(math.pi / 2,), sigma=20.0, outlier_fraction=0.2)
    single = RangeVectorModel(params, OccupancyGrid.from_bools(OCCUPIED, 1.0))
    ranges = np.arange(0.5, 500.0)
    total = sum(math.exp(single.log_likelihood(POSES[:, :1], RangeVector(np.array([z])))[0]) for z in ranges)
    assert total / (math.sqrt(2.0 * math.pi) * 20.0) == pytest.approx(1.0, abs=1e-4)


def test_batches_of_columns_have_the_bits_of_the_whole() -> None:
    generator = np.random.Generator(np.random.Philox(key=1))
    particles = (np.array([[620.0], [300.0], [6.0]]) * generator.random((3, 101))).astype(np.float32)
    for made in (model, partial(model, outlier_fraction=0.1)):
        whole = made().log_likelihood(particles, seen(POSES[:, 0]))
        halves = [made().log_likelihood(p, seen(POSES[:, 0])) for p in np.split(particles, [1, 37], axis=1)]
        assert np.concatenate(halves).tobytes() == whole.tobytes()


def test_a_reading_of_another_number_of_beams_and_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="one range for each of 5 beams"):
        model().log_likelihood(POSES, RangeVector(np.ones(4)))
    with pytest.raises(ValueError, match=r"RangeVectorParams.sigma = 0.0"):
        model(sigma=0.0)
