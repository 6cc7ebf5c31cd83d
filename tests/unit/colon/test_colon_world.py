"""Tubes, routes, and the capsule that moves through them."""

import numpy as np
import pytest

from dynpf.colon import CASES, ROUTE, Capsule, bore, simulate
from dynpf.colon.outline import HEIGHT, WIDTH, Bulge, Family, RoundEnd, tube
from dynpf.colon.world import BEAMS, timeline
from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster

PATH = ROUTE.poses()
ORIGIN = (-0.5, -0.5, 0.0)


def box(*walls: tuple[slice, slice]) -> OccupancyGrid:
    """A closed box of 60 x 40 cells, and more walls in it."""
    occupied = np.zeros((40, 60), dtype=bool)
    occupied[2], occupied[-3], occupied[:, 2], occupied[:, -3] = True, True, True, True
    for wall in walls:
        occupied[wall] = True
    return OccupancyGrid.from_bools(occupied, 1.0, ORIGIN)


ALONG = np.array([[10.0, 50.0], [20.0, 20.0]])


def test_the_route_is_colons() -> None:
    assert PATH.shape == (3, 16)
    np.testing.assert_allclose(PATH[:, 0], (150.0, 370.0, 0.0))
    np.testing.assert_allclose(PATH[:, 7], (700.0, 370.0, 0.0))
    np.testing.assert_allclose(PATH[:, -1], (820.0, 410.0, np.pi / 2))


@pytest.mark.parametrize("family", Family)
@pytest.mark.parametrize("seed", range(6))
def test_every_tube_is_closed_and_keeps_its_walls_off_the_route(family: Family, seed: int) -> None:
    grid = tube(family, seed).bore()
    assert grid.cells.shape == (HEIGHT, WIDTH)
    inside = bore(grid, PATH)
    clearance = distance_field(inside.occupied, 1.0)
    column, row = (np.floor(cells).astype(int) for cells in inside.to_cells(PATH[0], PATH[1]))
    assert clearance[row, column].min() > 10.0


def test_tubes_differ_between_seeds_and_families_and_not_from_themselves() -> None:
    cells = [tube(family, seed).bore().cells for family in Family for seed in range(2)]
    for i, one in enumerate(cells):
        for other in cells[i + 1 :]:
            assert np.sum(one != other) > 1000
    np.testing.assert_array_equal(tube(Family.FOLDS, 1).bore().cells, cells[3])


def test_a_bulge_moves_the_wall_by_its_size_there_and_nowhere_else() -> None:
    one = tube(Family.HAUSTRA, 0)
    plain, bulged = one.bore(), one.bore(Bulge(left=False, place=300.0))
    assert np.all(bulged.free[plain.free])
    changed = plain.cells != bulged.cells
    # The area of a bell; the centre line is curved, and walls have ridges.
    assert changed.sum() == pytest.approx(45.0 * 38.0 * np.sqrt(2.0 * np.pi), rel=0.1)
    assert not changed[:, 600:].any()


def test_a_round_end_is_a_circle_of_its_radius() -> None:
    grid = tube(Family.IRREGULAR, 2).round_ended(RoundEnd(120.0))
    angles = np.linspace(-0.45 * np.pi, 0.45 * np.pi, 50)
    ranges = RayCaster(grid).ranges(np.full(50, 820.0), np.full(50, 400.0), angles, 500.0)
    np.testing.assert_allclose(ranges, 120.0, atol=1.5)
    bore(grid, PATH)


def test_dirt_is_no_wall_and_a_bar_is() -> None:
    dirty = box((slice(18, 22), slice(30, 34)))
    assert bore(dirty, ALONG).free[20, 31]
    with pytest.raises(ValueError, match=r"drawing: the route meets a wall at \(30, 20\)"):
        bore(dirty, ALONG, "drawing", specks=0)


@pytest.mark.parametrize(
    ("grid", "route", "said"),
    [
        (OccupancyGrid.from_bools(np.ones((9, 9), dtype=bool), 1.0), ALONG, "no free space in 9 x 9"),
        (box(), ALONG + 100.0, r"comes to \(110, 120\), outside of the map's 60 x 40"),
        (box((slice(None), slice(30, 32))), ALONG, r"meets a wall at \(30, 20\)"),
        (box((slice(None), slice(10, 12))), ALONG, r"meets a wall at \(10, 20\)"),
        (OccupancyGrid.from_bools(np.zeros((40, 60), dtype=bool), 1.0), ALONG, "not closed"),
    ],
)
def test_what_is_wrong_with_a_drawing_is_told(grid: OccupancyGrid, route: np.ndarray, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        bore(grid, route)


def test_a_gap_in_the_outline_is_told() -> None:
    grid = box()
    cells = grid.cells.copy()
    cells[20, -3] = 0
    with pytest.raises(ValueError, match="not closed"):
        bore(OccupancyGrid(cells, 1.0, ORIGIN), ALONG)


def test_maps_change_before_the_eighth_motion() -> None:
    assert timeline("a", CASES[1].true).changes == ()
    change = timeline("a", CASES[5].true)
    assert [change.at(step) for step in (7, 8, 15)] == ["a", "c", "c"]
    growing = timeline("a", "x", "y", "c")
    assert [growing.at(step) for step in (7, 8, 9, 10)] == ["a", "x", "y", "c"]


@pytest.fixture(scope="module")
def casters() -> dict[str, RayCaster]:
    one = tube(Family.FOLDS, 3)
    return {"a": RayCaster(bore(one.bore(), PATH)), "b": RayCaster(bore(one.bore(Bulge(False, one.bend + 25.0)), PATH))}


def test_without_noise_the_capsule_is_on_the_route_and_reads_the_true_map(casters: dict[str, RayCaster]) -> None:
    run = simulate(casters, timeline("a", "b"), Capsule(), seed=1)
    np.testing.assert_allclose(run.poses, PATH)
    assert run.maps == ("a",) * 8 + ("b",) * 8
    for step in (0, 9):
        angles = PATH[2, step] + np.array(BEAMS)
        x, y = (np.full(5, value) for value in PATH[:2, step])
        exact = casters[run.maps[step]].ranges(x, y, angles, 500.0)
        np.testing.assert_array_equal(run.ranges[:, step], exact)
    assert (
        np.abs(run.ranges[:, 8:] - simulate(casters, timeline("a", "a"), Capsule(), seed=1).ranges[:, 8:]).max() > 20.0
    )


def test_noise_has_the_size_asked_for(casters: dict[str, RayCaster]) -> None:
    exact = simulate(casters, timeline("a", "a"), Capsule(), seed=0).ranges
    noisy = np.stack(
        [simulate(casters, timeline("a", "a"), Capsule(sigma_range=3.0), seed=s).ranges for s in range(20)]
    )
    errors = (noisy - exact)[:, exact < 480.0]
    assert np.std(errors) == pytest.approx(3.0, rel=0.1)
    lost = simulate(casters, timeline("a", "a"), Capsule(outlier_fraction=1.0), seed=3).ranges
    assert lost.std() > 100.0


def test_a_noisy_capsule_is_steered_along_the_route_and_stays_in_the_tube(casters: dict[str, RayCaster]) -> None:
    for seed in range(5):
        run = simulate(casters, timeline("a", "a"), Capsule(sigma=0.1, sigma_theta=0.1), seed=seed)
        off = np.hypot(*(run.poses[:2] - PATH[:2]))
        assert 0.0 < off.max() < 1.0
        assert np.std(run.poses[2, :14]) > 0.03
