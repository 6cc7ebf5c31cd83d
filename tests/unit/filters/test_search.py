"""A search of the whole map finds where a scan was taken, and a jump takes the filter there."""

import math
from typing import Any

import numpy as np
import pytest

from dynpf.filters.adaptation import Kld, KldParams
from dynpf.filters.cloud import uniform_cloud
from dynpf.filters.jump import Jump, JumpMemory, JumpParams
from dynpf.filters.models import Models
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.search import Places, Search, SearchStart
from dynpf.filters.start import pose_source
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.scan import Scan
from dynpf.motion.model import Displacement
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.rng import Stream
from dynpf.se2 import wrap_angle
from tests.unit.filters.two_rooms import FIELD, RANGE_MAX, START, flat, in_map, search_of, seen


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize("place", [(2.0, 1.9, 0.3), (6.5, 2.5, -2.4), (3.0, 4.2, -1.2)])
def test_a_scan_is_found_to_be_taken_where_it_was(yaw: float, place: tuple[float, float, float]) -> None:
    grid = flat(yaw)
    pose = in_map(grid, *place)
    found = search_of(grid).draw(200, [seen(grid, pose)], Stream.of(1, "test", 0))
    near = (np.hypot(*(found[:2] - pose[:2, None])) < 0.3) & (np.abs(wrap_angle(found[2] - pose[2])) < 0.2)
    assert near.mean() > 0.9


def test_the_evidence_is_the_mean_likelihood_over_the_free_space() -> None:
    grid = flat()
    scan = seen(grid, in_map(grid, 2.0, 1.9, 0.3))
    # Weak enough that poses drawn at random hit the peak.
    field = LikelihoodField(LikelihoodFieldParams(sigma_hit=0.3, tempering=0.05), grid)
    models = Models(OdometryMotion(OdometryParams()), {Scan: field})
    found = Search(SearchStart(spacing=0.2, kept=10**7, halvings=1), models, grid).places([scan])
    drawn = grid.sample_free(200_000, Stream.of(1, "test", 0))
    mean = np.mean(np.exp(field.log_likelihood(drawn, scan).astype(np.float64)))
    assert found.log_evidence == pytest.approx(math.log(mean), abs=0.05)
    assert found.weights.sum() == pytest.approx(1.0, abs=1e-4)
    best = found.poses[:, [int(np.argmax(found.weights))]]
    assert found.log_likelihood == pytest.approx(float(field.log_likelihood(best, scan)[0]), abs=0.1)


@pytest.mark.parametrize("readings", [[], [Scan(np.zeros(0, np.float32), np.zeros(0, np.float32), 0.0, RANGE_MAX)]])
def test_what_tells_nothing_leaves_all_of_the_free_space(readings: list[Scan]) -> None:
    grid = flat()
    search = search_of(grid, SearchStart(spacing=0.5, kept=10**6, halvings=0))
    poses = search.draw(5000, readings, Stream.of(1, "test", 0))
    assert search.places(readings).log_evidence == pytest.approx(0.0, abs=0.1)
    column, _ = grid.to_cells(poses[0], poses[1])
    assert np.mean(column < 90.0) == pytest.approx(0.5, abs=0.05)
    assert abs(np.mean(np.exp(1j * poses[2]))) < 0.05


def test_a_search_that_cannot_be_is_refused() -> None:
    grid = flat()
    still = OdometryMotion(OdometryParams())
    models = Models(still, {Scan: LikelihoodField(FIELD, grid)})
    with pytest.raises(ValueError, match="grid map"):
        pose_source(START, models=models)
    with pytest.raises(ValueError, match="can be smoothed"):
        Search(START, Models(still, {}), grid)
    with pytest.raises(ValueError, match=r"spacing = 0\.01: .* at most"):
        Search(SearchStart(spacing=0.01), models, grid)
    walls = OccupancyGrid(np.ones((4, 4), dtype=np.uint8), 0.1)
    with pytest.raises(ValueError, match="free space"):
        Search(START, Models(still, {Scan: LikelihoodField(FIELD, walls)}), walls)


def carried_off(*, jumps: bool) -> tuple[float, list[float]]:
    """Return the last error of a robot that is carried to the other room, and how likely a jump was at each update."""
    grid = flat()
    motion, field = OdometryMotion(OdometryParams()), LikelihoodField(FIELD, grid)
    search = search_of(grid)
    tracking = ParticleFilter(
        motion,
        {Scan: field},
        sizing=Kld(KldParams(cell_x=0.2, cell_y=0.2, n_min=300, n_max=1000)),
        rescue=Jump(JumpParams(), search) if jumps else None,
    )
    places = [(1.5 + 0.2 * k, 2.4, 0.1 * k) for k in range(8)] + [(5.6 + 0.2 * k, 1.5, 0.1 * k) for k in range(4)]
    scans = [[seen(grid, in_map(grid, *place))] for place in places]
    cloud = tracking.start(search.draw(500, scans[0], Stream.of(2, "test", 0)), Stream.of(2, "test", 0, "start"))
    told = []
    for step in range(1, len(places)):
        before, after = (in_map(grid, *place) for place in places[step - 1 : step + 1])
        dx, dy = after[:2] - before[:2]
        c, s = np.cos(before[2]), np.sin(before[2])
        move = (
            Displacement(float(c * dx + s * dy), float(c * dy - s * dx), 0.1)
            if step != 8
            else Displacement(0.2, 0.0, 0.1)
        )
        cloud, report = tracking.update(cloud, move, scans[step], Stream.of(2, "test", step))
        told.append(report.doubt.jumped if report.doubt else 0.0)
    return math.dist(report.estimate.mean[:2], in_map(grid, *places[-1])[:2]), told


def test_a_robot_that_is_carried_off_is_found_and_a_filter_without_jumps_stays_lost() -> None:
    error, told = carried_off(jumps=True)
    assert error < 0.15
    assert max(told[:7]) < 0.01
    assert max(told[7:]) > 0.5
    assert carried_off(jumps=False)[0] > 0.5


class Searched(Search):
    """A search that finds what it is told to, and counts how often it is asked."""

    def __init__(self, log_evidence: float, log_likelihood: float) -> None:
        self.found = Places(
            np.zeros((3, 1), np.float32), np.ones(1, np.float32), (0.1, 0.1), log_evidence, log_likelihood
        )
        self.asked = 0

    def places(self, readings: Any) -> Places:  # noqa: ARG002
        self.asked += 1
        return self.found


def assessed(jump: Jump, evidence: list[float], memory: tuple[float, ...] = (5.0, 20.0)) -> list[Any]:
    """Return the doubts at updates of one reading, of particles of equal weight."""
    cloud, doubts = uniform_cloud(np.zeros((3, 100), np.float32), memory), []
    for one in evidence:
        doubts.append(jump.doubt(cloud, one, 1, []))
        cloud = cloud._replace(memory=doubts[-1].memory)
    return doubts


def test_the_share_is_that_of_bayes_rule_and_is_asked_for_only_in_need() -> None:
    search = Searched(-3.0, 5.0)
    jump = Jump(JumpParams(probability=0.1, drop=6.0), search)
    fine, bad = assessed(jump, [0.0, -4.0])
    assert fine.share == 0.0
    assert fine.places is None
    assert bad.share == pytest.approx(0.1 * math.exp(-3.0) / (0.1 * math.exp(-3.0) + 0.9 * math.exp(-4.0)))
    assert search.asked == 1


def test_what_the_best_places_gain_adds_up_until_it_is_enough() -> None:
    jump = Jump(JumpParams(probability=1e-4, drop=6.0), Searched(-8.0, 5.0))
    doubts = assessed(jump, [-4.0] * 6)
    shares = [one.share for one in doubts]
    assert shares == sorted(shares)
    assert shares[0] < 1e-4
    assert shares[-1] > 0.5
    # As usual for once, and all that was gained is forgotten.
    assert JumpMemory(*assessed(jump, [-4.0, -4.0, 5.0])[-1].memory).gain == 0.0


def test_searches_in_vain_become_rare_and_are_counted() -> None:
    search = Searched(-20.0, -8.0)
    doubts = assessed(Jump(JumpParams(patience=4), search), [-9.0] * 16, (5.0, 1e6))
    assert [k for k, one in enumerate(doubts) if one.places is not None] == [0, 2, 6, 10, 14]
    assert doubts[-1].unfit == 5
    assert search.asked == 5


def test_what_is_never_explained_does_not_become_usual() -> None:
    doubts = assessed(Jump(JumpParams(log_likelihood_lost=-5.0), Searched(-30.0, -10.0)), [-11.0] * 8, (-11.0, 20.0))
    assert doubts[-1].unfit == 3
    assert assessed(Jump(JumpParams(), Searched(-30.0, -10.0)), [-11.0] * 8, (-11.0, 20.0))[-1].unfit == 0


def test_particles_that_were_set_down_and_grew_tell_of_a_jump() -> None:
    jump = Jump(JumpParams(), Searched(-20.0, 5.0))
    grown = uniform_cloud(np.zeros((3, 100), np.float32), JumpMemory(5.0, 20.0, share=0.1))
    assert jump.doubt(grown, 5.0, 1, []).jumped == pytest.approx(0.1)
    weights = np.full(100, 0.1 / 90, np.float32)
    weights[90:] = 0.09
    assert jump.doubt(grown._replace(weights=weights), 5.0, 1, []).jumped == pytest.approx(0.9)
    # What was told already is not told again.
    told = grown._replace(weights=weights, memory=JumpMemory(5.0, 20.0, share=0.9))
    assert jump.doubt(told, 5.0, 1, []).jumped == 0.0
