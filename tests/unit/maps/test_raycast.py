import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.reference import rays as reference
from dynpf.types import Float32s, FloatArray

RESOLUTION = 0.05
Pose = tuple[float, float, float]


def random_grid(seed: int, shape: tuple[int, int], density: float, origin: Pose = (0.0, 0.0, 0.0)) -> OccupancyGrid:
    """Blocks and single cells, so that there is room to leap over."""
    draw = np.random.default_rng(seed)
    occupied = draw.random(shape) < density
    for row, column in draw.integers(0, shape, (6, 2)):
        occupied[row : row + 9, column : column + 5] = True
    return OccupancyGrid.from_bools(occupied, RESOLUTION, origin)


def random_rays(grid: OccupancyGrid, count: int, seed: int, beyond: float = 0.0) -> list[Float32s]:
    draw = np.random.default_rng(seed)
    height, width = grid.cells.shape
    column = draw.uniform(-beyond, width + beyond, count)
    row = draw.uniform(-beyond, height + beyond, count)
    x, y = grid.to_map(column, row)
    return [values.astype(np.float32) for values in (x, y, draw.uniform(-7.0, 7.0, count))]


def by_reference(
    grid: OccupancyGrid, x: Float32s, y: Float32s, angles: Float32s, range_max: float, *, shift: float = 0.0
) -> FloatArray:
    """Return lengths in cells of rays that are shifted sideways by so many cells."""
    column, row = grid.to_cells(x, y)
    direction = angles.astype(np.float64) - grid.origin[2]
    column, row = column - shift * np.sin(direction), row + shift * np.cos(direction)
    return reference.cast(grid.occupied, column, row, direction, range_max / RESOLUTION)


@pytest.mark.parametrize(
    ("shape", "density", "origin", "beyond"),
    [
        ((150, 211), 0.002, (0.0, 0.0, 0.0), 0.0),
        ((97, 130), 0.02, (-3.0, 4.5, 0.7), 30.0),
        ((64, 40), 0.2, (12.0, -8.0, -2.9), 300.0),
        ((1, 300), 0.01, (0.0, 0.0, 1.6), 5.0),
    ],
)
def test_rays_end_where_a_walk_from_cell_to_cell_ends(
    shape: tuple[int, int], density: float, origin: Pose, beyond: float
) -> None:
    grid, range_max = random_grid(1, shape, density, origin), 6.0
    x, y, angles = random_rays(grid, 30_000, 2, beyond)
    ranges = RayCaster(grid).ranges(x, y, angles, range_max) / RESOLUTION
    expected = by_reference(grid, x, y, angles, range_max)
    assert np.mean(expected < range_max / RESOLUTION - 1.0) > 0.02
    astray = np.abs(ranges - expected) > 1e-2
    # Where a corner is passed more closely than float32 can tell, either side of it will do.
    assert np.mean(astray) < 2e-4
    grazing = x[astray], y[astray], angles[astray], range_max
    beside = np.stack([by_reference(grid, *grazing, shift=shift) for shift in (-2e-3, 2e-3)])
    assert (np.abs(ranges[astray] - beside).min(axis=0, initial=np.inf) <= 1.0).all()


@given(
    arrays(np.uint8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.sampled_from([0, 0, 0, 1])),
    st.booleans(),
)
def test_a_cone_is_free_and_cannot_be_longer(occupied: NDArray[np.uint8], crowded: bool) -> None:
    occupied = occupied if crowded else occupied * (np.arange(occupied.size).reshape(occupied.shape) % 5 == 0)
    occupied = occupied.astype(np.uint8)
    rows, columns = occupied.shape
    table = np.zeros((rows + 2) * columns, dtype=np.uint8)
    kernels.rays.fill_cones(occupied, table)
    padded = np.zeros((rows + 200, columns + 200), dtype=bool)
    padded[:rows, :columns] = occupied
    for row in range(rows):
        for column in range(columns):
            free = 0
            while free < 127 and not padded[row : row + free + 2, column + free].any():
                free += 1
            value = table[row * columns + column]
            if padded[row, column]:
                assert value == 0
            else:
                assert value == (free or 129)
                assert (free == 0) == padded[row + 1, column]


def test_a_ray_does_not_depend_on_the_others() -> None:
    grid = random_grid(3, (120, 80), 0.01)
    x, y, angles = random_rays(grid, 2000, 4, 5.0)
    caster = RayCaster(grid)
    whole = caster.ranges(x, y, angles, 10.0)
    order = np.random.default_rng(5).permutation(2000)
    np.testing.assert_array_equal(caster.ranges(x[order], y[order], angles[order], 10.0), whole[order])
    pieces = [caster.ranges(x[i : i + 77], y[i : i + 77], angles[i : i + 77], 10.0) for i in range(0, 2000, 77)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


def wall() -> NDArray[np.uint8]:
    """A wall that stands between x = 2 and x = 2.05 m of the grid's frame, unknown cells before it."""
    cells = np.full((80, 60), FREE, dtype=np.uint8)
    cells[:, 40] = OCCUPIED
    cells[:, 20:30] = UNKNOWN
    return cells


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (7.0, -3.0, 2.1)])
def test_a_wall_is_met_where_its_plane_is(origin: Pose) -> None:
    grid = OccupancyGrid(wall(), RESOLUTION, origin)
    directions = np.linspace(-0.9, 0.9, 41)
    x, y = grid.to_map(np.full(41, 10.3), np.full(41, 40.4))
    ranges = RayCaster(grid).ranges(x, y, directions + origin[2], 2.0)
    np.testing.assert_allclose(ranges, np.minimum((40 - 10.3) * RESOLUTION / np.cos(directions), 2.0), rtol=3e-6)


def test_rays_along_the_axes_and_diagonals_meet_a_frame_around_them() -> None:
    occupied = np.ones((21, 21), dtype=bool)
    occupied[1:-1, 1:-1] = False
    angles = np.arange(-8, 9) * np.pi / 4
    centre = np.full(17, 10.5)
    ranges = RayCaster(OccupancyGrid.from_bools(occupied, 1.0)).ranges(centre, centre, angles, 50.0)
    np.testing.assert_allclose(ranges, np.where(np.arange(17) % 2, 9.5 * np.sqrt(2.0), 9.5), rtol=1e-6)


def test_rays_from_outside_enter_the_grid_and_those_that_miss_it_go_on_for_ever() -> None:
    caster = RayCaster(OccupancyGrid(wall(), RESOLUTION))
    x, y, angles = np.array([-5.0, 12.0, -5.0, 1.0, 30.0]), np.full(5, 2.0), np.array([0.0, np.pi, np.pi, 0.0, 1.0])
    y[3] = -1.0
    np.testing.assert_allclose(caster.ranges(x, y, angles, 50.0), [7.0, 9.95, 50.0, 50.0, 50.0], rtol=1e-6)
    np.testing.assert_array_equal(caster.ranges(x, y, angles, 6.0), np.full(5, 6.0, dtype=np.float32))


def test_from_within_a_wall_the_range_is_zero_and_from_no_place_at_all_it_is_the_greatest() -> None:
    caster = RayCaster(OccupancyGrid(wall(), RESOLUTION))
    angles = np.linspace(-3.0, 3.0, 7)
    np.testing.assert_array_equal(caster.ranges(np.full(7, 2.03), np.full(7, 1.01), angles, 9.0), np.zeros(7))
    odd = np.array([[np.nan, 1, 0], [1, np.nan, 0], [1, 1, np.nan], [np.inf, 1, 3], [1, -np.inf, 1], [1, 1, np.inf]])
    np.testing.assert_array_equal(
        caster.ranges(odd[:, 0], odd[:, 1], odd[:, 2], 0.1), np.full(6, 0.1, dtype=np.float32)
    )
    assert caster.ranges([], [], [], 9.0).shape == (0,)


def test_what_is_no_set_of_rays_is_refused() -> None:
    caster = RayCaster(OccupancyGrid(wall(), RESOLUTION))
    with pytest.raises(ValueError, match=r"shapes \(1,\), \(1,\) and \(2,\)"):
        caster.ranges([1.0], [1.0], [0.0, 1.0], 9.0)
    for range_max in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="must be above 0"):
            caster.ranges([1.0], [1.0], [0.0], range_max)
