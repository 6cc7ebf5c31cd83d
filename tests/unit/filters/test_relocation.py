"""A slip is mended at once, another place is believed after several scans; alike and unmapped places are not."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynpf.filters.cloud import Cloud
from dynpf.filters.particle import ParticleFilter, Report
from dynpf.filters.refinement import ScanMatching, ScanMatchingParams
from dynpf.filters.relocation import Relocation, RelocationParams, recalled
from dynpf.filters.start import KnownStart, start_poses
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.likelihood_field import LikelihoodField
from dynpf.measurement.scan import Scan
from dynpf.motion.model import Displacement
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.rng import Stream
from dynpf.se2 import relative
from tests.unit.filters.two_rooms import FIELD, RANGE_MAX, flat, in_map, search_of, seen

PARAMS = RelocationParams(log_likelihood_lost=-0.2)
ROUND = [(1.5 + 0.15 * k, 2.4 + 0.05 * k, 0.1 * k) for k in range(8)]
ELSEWHERE = [(5.6 + 0.15 * k, 1.5, 0.8 + 0.1 * k) for k in range(10)]


def drive(
    grid: OccupancyGrid,
    places: Sequence[tuple[float, float, float]],
    scans: Sequence[Scan] | None = None,
    slips: dict[int, tuple[float, float, float]] | None = None,
) -> list[tuple[float, Report, Cloud]]:
    """Return the error, the report and the cloud at each place after the first; odometry is exact but for its slips."""
    search = search_of(grid)
    motion, field = (
        OdometryMotion(OdometryParams(growth="linear", alpha_1=0.02, alpha_2=0.01)),
        LikelihoodField(FIELD, grid),
    )
    tracking = ParticleFilter(motion, {Scan: field}, rescue=Relocation(PARAMS, search))
    poses = [in_map(grid, *place) for place in places]
    start = KnownStart(**dict(zip(("x", "y", "theta"), poses[0].tolist(), strict=True)))
    cloud = tracking.start(start_poses(start, 500, Stream.of(3, "test", 0)), Stream.of(3, "test", 0, "start"))
    found = []
    for step in range(1, len(poses)):
        made = relative(poses[step - 1], poses[step]) + np.array((slips or {}).get(step, (0.0, 0.0, 0.0)))
        scan = seen(grid, poses[step]) if scans is None else scans[step]
        cloud, report = tracking.update(cloud, Displacement(*made.tolist()), [scan], Stream.of(3, "test", step))
        found.append((math.dist(report.estimate.mean[:2], poses[step][:2]), report, cloud))
    return found


def test_a_slip_is_mended_by_the_very_scan_and_is_no_jump() -> None:
    found = drive(flat(), ROUND, slips={4: (0.3, 0.0, math.radians(20.0))})
    assert max(error for error, _, _ in found) < 0.1
    settled = [report.doubt.settled for _, report, _ in found if report.doubt]
    assert settled[3]
    assert not any(report.doubt.jumped for _, report, _ in found if report.doubt)


def carried(off: int) -> dict[int, tuple[float, float, float]]:
    """Return the slip that hides from odometry that the robot was carried off before a step."""
    grid = flat()
    before, after = in_map(grid, *ROUND[-1]), in_map(grid, *ELSEWHERE[0])
    hidden = -relative(before, after)
    return {off: (float(hidden[0]) + 0.15, float(hidden[1]), float(hidden[2]))}


def test_another_place_is_believed_once_it_has_explained_several_scans() -> None:
    found = drive(flat(), [*ROUND, *ELSEWHERE], slips=carried(len(ROUND)))
    after = found[len(ROUND) - 1 :]
    jumps = [index for index, (_, report, _) in enumerate(after) if report.doubt and report.doubt.jumped]
    assert jumps == [PARAMS.scans - 1]
    assert all(error < 0.15 for error, _, _ in after[PARAMS.scans - 1 :])
    unexplained = [report.doubt.unexplained for _, report, _ in after[: PARAMS.scans - 1] if report.doubt]
    assert unexplained == [1, 2, 3, 4]


def test_of_places_that_look_alike_none_is_taken() -> None:
    grid = flat()
    cells = np.array(grid.cells)
    cells[:, 91:] = cells[:, 90::-1][:, : cells.shape[1] - 91]  # both rooms, and what they look like turned about
    cells = np.concatenate([cells, cells])
    twins = OccupancyGrid(cells, grid.resolution, grid.origin)
    scans = [seen(grid, in_map(grid, *place)) for place in [*ROUND, *ROUND]]
    # Set down in the twin of the room, at the other end of it, again and again seen from there.
    places = [*ROUND, *((x, y + 6.0, turn) for x, y, turn in ROUND)]
    found = drive(twins, places, scans)
    assert not any(report.doubt.jumped for _, report, _ in found if report.doubt)


def test_off_the_map_the_particles_go_on_by_odometry_and_the_readings_are_not_taken_in() -> None:
    grid = flat()
    strange = Scan(np.linspace(-2.0, 2.0, 90, dtype=np.float32), np.full(90, 0.9, np.float32), 0.0, RANGE_MAX)
    scans: list[Any] = [seen(grid, in_map(grid, *place)) for place in ROUND[:4]] + [strange] * 4
    found = drive(grid, ROUND, scans)
    assert all(error < 0.15 for error, _, _ in found)
    told = [report.doubt.unheard for _, report, _ in found if report.doubt]
    assert told == [0, 0, 0, 1, 2, 3, 4]
    # What is usual is not learned from what is not on the map.
    usual = [recalled(cloud.memory).usual for _, _, cloud in found]
    assert usual[-1] == usual[2]


def test_scan_matching_gives_particles_the_moments_that_a_sharper_model_finds() -> None:
    grid = flat()
    pose = in_map(grid, 2.0, 2.4, 0.3)
    models = search_of(grid)._levels[-1]
    matching = ScanMatching(ScanMatchingParams(), models)
    known = KnownStart(x=float(pose[0]) + 0.08, y=float(pose[1]) - 0.06, theta=float(pose[2]) + 0.04)
    tracking = ParticleFilter(OdometryMotion(OdometryParams()), {Scan: LikelihoodField(FIELD, grid)})
    cloud = tracking.start(start_poses(known, 500, Stream.of(1, "test", 0)), Stream.of(1, "test", 1))
    before = tracking.estimate(cloud.particles, cloud.weights)
    moved = matching.refine(cloud, [seen(grid, pose)], Stream.of(1, "test", 2))
    after = tracking.estimate(moved, cloud.weights)
    told = matching.matched(before, [seen(grid, pose)], Stream.of(1, "test", 2))
    assert told is not None
    assert np.allclose(after.mean, told.mean, atol=1e-4)
    assert np.allclose(after.covariance, told.covariance, rtol=1e-2, atol=1e-7)
    assert math.dist(after.mean[:2], pose[:2]) < 0.7 * math.dist(before.mean[:2], pose[:2])
    # The control: of a belief all over the room there is no one mode.
    wide = cloud._replace(particles=start_poses(KnownStart(sigma_position=2.0), 500, Stream.of(1, "test", 3)))
    assert matching.refine(wide, [seen(grid, pose)], Stream.of(1, "test", 4)) is wide.particles
