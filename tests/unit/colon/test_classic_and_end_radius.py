"""COLON's own filter, and the family of round ends."""

import numpy as np
import pytest

from dynpf.colon import CASES, ROUTE, Capsule, bore, simulate
from dynpf.colon.beams import expected_ranges
from dynpf.colon.classic import Classic
from dynpf.colon.end_radius import EndRadius, EndRadiusParams
from dynpf.colon.outline import Bulge, Family, RoundEnd, tube
from dynpf.colon.world import Run, timeline
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.rng import Stream

START = np.repeat(np.array([[150.0], [370.0], [0.0]]), 100, axis=1)
TUBE = tube(Family.FOLDS, 2)


def ended(radius: float) -> OccupancyGrid:
    return bore(TUBE.round_ended(RoundEnd(radius)), ROUTE.poses())


@pytest.fixture(scope="module")
def family() -> EndRadius:
    return EndRadius(EndRadiusParams(), {float(radius): ended(radius) for radius in range(95, 156, 10)})


@pytest.fixture(scope="module")
def bulging() -> dict[str, OccupancyGrid]:
    maps = {"a": TUBE.bore(), "b": TUBE.bore(Bulge(False, TUBE.bend + 25.0))}
    return {name: bore(grid, ROUTE.poses()) for name, grid in maps.items()}


@pytest.mark.parametrize("case", [1, 2, 3, 4])
@pytest.mark.parametrize("count", [1, 20])
def test_colons_filter_ends_in_every_case(bulging: dict[str, OccupancyGrid], case: int, count: int) -> None:
    told, classic = timeline("a", CASES[case].told), Classic(bulging)
    run = simulate(
        {name: RayCaster(grid) for name, grid in bulging.items()}, timeline("a", CASES[case].true), Capsule(), 1
    )
    cloud = classic.start(START[:, :count], Stream.of(1, "start", 0))
    for step, ranges in enumerate(run.ranges.T):
        motion = run.motions[step - 1] if step else None
        cloud, found = classic.update(cloud, motion, ranges, Stream.of(1, "test", step), told.at(step))
    assert np.isfinite(found.pose).all()
    assert np.hypot(*(found.pose - run.poses[:, -1])[:2]) < 60.0
    assert (found.program_pose.astype(np.float32) == cloud.particles[:3].T).all(axis=1).any()


def test_colons_filter_goes_on_where_no_particle_is_in_the_map(bulging: dict[str, OccupancyGrid]) -> None:
    classic, outside = Classic(bulging), START.copy()
    outside[1] = 20.0
    cloud = classic.start(outside, Stream.of(1, "start", 0))
    cloud, found = classic.update(cloud, ROUTE.motions[0], np.full(5, 80.0), Stream.of(1, "test", 0), "b")
    assert found.pose[:2] == pytest.approx((250.0, 20.0), abs=3.0)


def run_with(radius: float) -> Run:
    casters = {"a": RayCaster(ended(105.0)), "x": RayCaster(ended(radius))}
    return simulate(casters, timeline("a", "x"), Capsule(), seed=2)


@pytest.mark.parametrize("radius", [105.0, 118.0, 135.0])
def test_the_radius_is_found_listed_or_not(family: EndRadius, radius: float) -> None:
    run, cloud = run_with(radius), family.start(START, 105.0)
    for step, ranges in enumerate(run.ranges.T):
        motion = run.motions[step - 1] if step else None
        cloud, found = family.update(cloud, motion, ranges, Stream.of(3, "test", step))
    assert found.radius == pytest.approx(radius, rel=0.02)
    assert np.hypot(*(found.pose - run.poses[:, -1])[:2]) < 4.0


def test_between_two_members_ranges_are_about_those_of_the_map_between(family: EndRadius) -> None:
    poses = np.array([[780.0, 820.0], [370.0, 400.0], [0.0, 1.0]], dtype=np.float32)
    between = family._expected(np.vstack((poses, [[120.0, 120.0]])).astype(np.float32))
    np.testing.assert_allclose(between, expected_ranges(RayCaster(ended(120.0)), poses), atol=2.0)
    member = family._expected(np.vstack((poses, [[115.0, 155.0]])).astype(np.float32))
    np.testing.assert_array_equal(member[:, 0], expected_ranges(RayCaster(ended(115.0)), poses)[:, 0])
    np.testing.assert_array_equal(member[:, 1], expected_ranges(RayCaster(ended(155.0)), poses)[:, 1])


def test_a_family_of_one_is_none() -> None:
    with pytest.raises(ValueError, match="two at least"):
        EndRadius(EndRadiusParams(), {105.0: ended(105.0)})
