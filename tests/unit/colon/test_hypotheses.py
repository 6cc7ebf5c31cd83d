"""The filter over poses and maps, in one tube."""

import numpy as np
import pytest

from dynpf.colon import CASES, ROUTE, Capsule, bore, simulate
from dynpf.colon.hypotheses import UNLISTED, Belief, Finding, Hypotheses, HypothesesParams
from dynpf.colon.outline import Bulge, Family, tube
from dynpf.colon.wall import Wall
from dynpf.colon.world import Run, timeline
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.rng import Stream

START = np.repeat(np.array([[150.0], [370.0], [0.0]]), 100, axis=1)


@pytest.fixture(scope="module")
def maps() -> dict[str, OccupancyGrid]:
    one = tube(Family.HAUSTRA, 1)
    bulges = {"a": [], "b": [Bulge(False, one.bend + 25.0)], "c": [Bulge(False, one.bend + 115.0)]}
    return {name: bore(one.bore(*there), ROUTE.poses()) for name, there in bulges.items()}


@pytest.fixture(scope="module")
def runs(maps: dict[str, OccupancyGrid]) -> dict[int, Run]:
    casters = {name: RayCaster(grid) for name, grid in maps.items()}
    return {case: simulate(casters, timeline("a", CASES[case].true), Capsule(), seed=case) for case in CASES}


@pytest.fixture(scope="module")
def hypotheses(maps: dict[str, OccupancyGrid]) -> Hypotheses:
    return Hypotheses(HypothesesParams(), {"a": maps["a"], "b": maps["b"]})


def follow(
    hypotheses: Hypotheses, run: Run, belief: Belief, seed: int = 0, told: str | None = None
) -> tuple[Belief, list[Finding]]:
    found = []
    for step, ranges in enumerate(run.ranges.T):
        stream = Stream.of(seed, "test", step)
        said = told if step == ROUTE.change + 1 else None
        belief, finding = hypotheses.update(belief, run.motions[step - 1] if step else None, ranges, stream, said)
        found.append(finding)
    return belief, found


@pytest.mark.parametrize("case", CASES)
def test_in_every_case_the_pose_and_the_map_are_found(hypotheses: Hypotheses, runs: dict[int, Run], case: int) -> None:
    run, told = runs[case], CASES[case].told
    _, found = follow(hypotheses, run, hypotheses.start(START), told=told if told != "a" else None)
    assert np.hypot(*(found[-1].pose - run.poses[:, -1])[:2]) < 2.5
    assert found[-1].pose[2] == pytest.approx(run.poses[2, -1], abs=0.05)
    truth = UNLISTED if CASES[case].true == "c" else CASES[case].true
    assert found[-1].maps[truth] > 0.95
    assert sum(found[-1].maps.values()) == pytest.approx(1.0)
    if truth != "a":
        assert found[-1].changed_at == pytest.approx(8.0, abs=0.5)


def test_the_deformation_is_where_the_wall_has_moved_and_nowhere_else(
    runs: dict[int, Run], maps: dict[str, OccupancyGrid]
) -> None:
    alone = Hypotheses(HypothesesParams(), {"a": maps["a"]})
    _, found = follow(alone, runs[5], alone.start(START))
    assert found[-1].maps[UNLISTED] > 0.95
    moved = np.abs(found[-1].displacement) > 15.0
    column, row = alone.walls[0].places[:, moved]
    changed = np.argwhere(maps["a"].cells != maps["c"].cells)
    gaps = np.hypot(column[:, None] - changed[:, 1], row[:, None] - changed[:, 0]).min(axis=1)
    assert 1 <= moved.sum() <= 8
    assert gaps.max() < 15.0
    assert found[-1].displacement.max() == pytest.approx(45.0, abs=12.0)


def test_a_map_that_stays_is_never_called_changed(hypotheses: Hypotheses, runs: dict[int, Run]) -> None:
    _, found = follow(hypotheses, runs[1], hypotheses.start(START))
    assert min(finding.maps["a"] for finding in found) > 0.5


def test_a_pose_is_found_from_anywhere(hypotheses: Hypotheses, runs: dict[int, Run]) -> None:
    belief, found = follow(hypotheses, runs[2], hypotheses.anywhere(Stream.of(1, "start", 0)), seed=1)
    assert belief.settled
    assert belief.cloud.particles.shape == (3, 100)
    assert np.hypot(*(found[-1].pose - runs[2].poses[:, -1])[:2]) < 3.0
    assert found[-1].maps["b"] > 0.9


def test_the_same_streams_give_the_same_belief(hypotheses: Hypotheses, runs: dict[int, Run]) -> None:
    one, other, another = (follow(hypotheses, runs[5], hypotheses.start(START), seed=s)[0] for s in (3, 3, 4))
    np.testing.assert_array_equal(one.cloud.particles, other.cloud.particles)
    np.testing.assert_array_equal(one.displacement, other.displacement)
    assert not np.array_equal(one.cloud.particles, another.cloud.particles)


def test_a_forced_schedule_leaves_no_other_map(maps: dict[str, OccupancyGrid], runs: dict[int, Run]) -> None:
    forced = Hypotheses(HypothesesParams().obedient(), {"a": maps["a"], "b": maps["b"]})
    _, found = follow(forced, runs[1], forced.start(START), told="b")
    assert found[7].maps == {"a": 1.0, "b": 0.0, UNLISTED: 0.0}
    assert found[-1].maps == {"a": 0.0, "b": 1.0, UNLISTED: 0.0}
    assert np.isfinite(found[-1].pose).all()


@pytest.mark.parametrize("ranges", [[np.nan] * 5, [0.0] * 5, [500.0] * 5, [np.inf, -1.0, 20.0, np.nan, 1e9]])
def test_whatever_is_read_the_belief_stays_whole(hypotheses: Hypotheses, ranges: list[float]) -> None:
    belief = hypotheses.start(START)
    for step in range(3):
        belief, finding = hypotheses.update(belief, ROUTE.motions[0], np.array(ranges), Stream.of(1, "test", step))
    assert np.isfinite(finding.pose).all()
    assert np.isfinite(belief.displacement).all()
    np.testing.assert_allclose(belief.maps.sum(axis=0), 1.0, rtol=1e-5)


def test_a_reading_that_tells_nothing_changes_no_weight(hypotheses: Hypotheses) -> None:
    belief = hypotheses.start(START)
    after, finding = hypotheses.update(belief, None, np.full(5, np.nan), Stream.of(1, "test", 0))
    np.testing.assert_allclose(after.cloud.weights, 0.01, rtol=1e-5)
    assert finding.maps["a"] == pytest.approx(1.0 - hypotheses.params.change, abs=1e-4)


def test_bad_usage_is_told(hypotheses: Hypotheses, maps: dict[str, OccupancyGrid]) -> None:
    belief, stream = hypotheses.start(START), Stream.of(1, "test", 0)
    with pytest.raises(ValueError, match=r"shape \(3,\); expected one for each of 5"):
        hypotheses.update(belief, None, np.ones(3), stream)
    with pytest.raises(ValueError, match="told of map 'c': expected one of a, b"):
        hypotheses.update(belief, None, np.ones(5), stream, told="c")
    with pytest.raises(ValueError, match="no map is listed"):
        Hypotheses(HypothesesParams(), {})
    small = OccupancyGrid.from_bools(np.ones((9, 9), dtype=bool), 1.0)
    with pytest.raises(ValueError, match="a, b differ in size"):
        Hypotheses(HypothesesParams(), {"a": maps["a"], "b": small})


def test_the_wall_of_a_disc_is_a_ring_at_its_radius() -> None:
    y, x = np.mgrid[:200, :220]
    away = np.hypot(x - 110, y - 100)
    wall = Wall.of(OccupancyGrid.from_bools(away > 60.0, 1.0), spacing=25.0, length=35.0, deviation=20.0)
    near = np.abs(away - 60.0) < 30.0
    np.testing.assert_allclose(wall.beyond[near], (away - 60.0)[near], atol=1.0)
    np.testing.assert_allclose(np.hypot(wall.places[0] - 110, wall.places[1] - 100), 60.0, atol=1.5)
    # The chain of its pixels is a little longer than a circle is.
    assert len(wall.following) == pytest.approx(2.0 * np.pi * 60.0 / 25.0, abs=2.0)
    np.testing.assert_allclose(np.diag(wall.prior), 400.0)
    assert np.linalg.eigvalsh(wall.prior.astype(np.float64)).min() > 0.0
    # A point's place on the ring is that of its direction.
    position = wall.node + wall.share
    turn = np.arctan2(y - 100, x - 110)
    for angle in (0.3, 1.5, 3.0):
        there = near & (np.abs(turn - angle) < 0.02)
        assert np.ptp(position[there]) < 0.6
