"""How well the readings of a run fit its estimates, which needs no truth: beams near walls, and their evidence."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from dynpf_experiments.messages import RunMessages, of_type
from dynpf_experiments.pictures.columns import evenly
from dynpf_protocol.errors import DynpfError
from dynpf_protocol.messages import Estimate, FilterHealth, LaserScan, Scanner
from dynpf_services.scenario.context import Context
from msgspec import UNSET, UnsetType
from numpy.typing import NDArray

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.scan import Scan
from dynpf.metrics.trajectory import Trajectory
from dynpf.types import FloatArray
from dynpf_systems.rooms.localization.readings import reading_of
from dynpf_systems.rooms.maps import maps_of
from dynpf_systems.rooms.wall_fit import WallFit

__all__ = ["TimedScan", "estimated_path", "fit_of", "fit_where_tracking", "poses_at", "tracking"]

NEAR_M = 0.1
"""A beam of a run ends near a wall up to this distance, m."""

SCANS = 60
"""Scans of a run that are compared, at even distances."""


class TimedScan(NamedTuple):
    """A scan and its time, s."""

    stamp: float
    scan: Scan


def fit_of(run: RunMessages, estimator: str = "estimator") -> dict[str, float]:
    """Return how well an estimator's readings fit its estimates; what a run has no data for is left out.

    - ``near_walls_fraction``: of the beams with a return, those that end within 10 cm of a wall of the map when their
      scan is taken at the estimate; the median over scans evenly spaced in time
    - ``near_walls_by_chance_fraction``: the same at poses drawn from the free space of the map
    - ``log_likelihood``: of one reading, natural logarithm; the mean over the estimates of the health monitor's average
    """
    told = [health.figures.log_likelihood for health in _healths(run, estimator) if health is not UNSET]
    values = [value for value in told if value is not UNSET]
    found = {"log_likelihood": float(np.mean(values))} if values else {}
    scans = _scans(run, estimator.rpartition("/")[0])
    grid = _grid(run) if scans else None
    if grid is None:
        return found
    walls = WallFit(grid, NEAR_M)
    poses, inside = poses_at(estimated_path(run, estimator), np.array([timed.stamp for timed in scans]))
    shares = {
        "near_walls_fraction": walls.share([scans[index].scan for index in inside], poses) if inside.size else math.nan,
        "near_walls_by_chance_fraction": walls.by_chance([timed.scan for timed in scans]),
    }
    return {name: value for name, value in shares.items() if math.isfinite(value)} | found


def fit_where_tracking(run: RunMessages, scans: Sequence[TimedScan], walls: WallFit) -> float:
    """Return the share of beams near walls where the estimator says that it is on its track, or else anywhere.

    NaN where no scan has an estimate.
    """
    path = estimated_path(run, "estimator")
    poses, inside = poses_at(path, np.array([timed.stamp for timed in scans]))
    if not inside.size:
        return math.nan
    on_track = tracking(run, "estimator")
    newest = np.searchsorted(path.stamps, [scans[index].stamp for index in inside], side="right") - 1
    chosen = on_track[newest] if on_track[newest].any() else np.ones(inside.size, dtype=np.bool_)
    return walls.share([scans[index].scan for index in inside[chosen]], poses[:, chosen])


def poses_at(path: Trajectory, stamps: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the poses of a path at those stamps that it spans, (3, T), and the indices of these stamps, (T,)."""
    if path.stamps.size < 2:
        return np.empty((3, 0)), np.empty(0, dtype=np.intp)
    inside = np.flatnonzero((stamps >= path.stamps[0]) & (stamps <= path.stamps[-1]))
    x, y, theta = path.poses
    rows = (x, y, np.unwrap(theta))
    return np.stack([np.interp(stamps[inside], path.stamps, row) for row in rows]), inside


def estimated_path(run: RunMessages, estimator: str) -> Trajectory:
    """Return the estimates of an estimator as a path."""
    timed = run.topic(f"{estimator}/state")
    poses = np.array([(state.x, state.y, state.theta) for state in of_type(timed, Estimate)]).reshape(-1, 3).T
    return Trajectory(np.array([message.stamp_ns * 1e-9 for message in timed]), poses)


def tracking(run: RunMessages, estimator: str) -> NDArray[np.bool_]:
    """Return at which estimates an estimator says that it is on its track, (T,)."""
    return np.array([health is not UNSET and health.status == "tracking" for health in _healths(run, estimator)], bool)


def _healths(run: RunMessages, estimator: str) -> list[FilterHealth | UnsetType]:
    return [state.health for state in of_type(run.topic(f"{estimator}/state"), Estimate)]


def _scans(run: RunMessages, robot: str) -> list[TimedScan]:
    """Return scans of the robot's first scanner, evenly spaced, each as its scanner was announced last."""
    topics = [name for name in run.carrying(LaserScan) if name.startswith(f"{robot}/" if robot else "")]
    announcements = [name for name in run.carrying(Scanner) if name.startswith(f"{robot}/" if robot else "")]
    if not topics or not announcements:
        return []
    scanners, scans = run.topic(announcements[0]), run.topic(topics[0])
    stamps = [timed.stamp_ns for timed in scanners]
    found = []
    for timed in (scans[index] for index in evenly(len(scans), SCANS)):
        number = max(int(np.searchsorted(stamps, timed.stamp_ns, side="right")) - 1, 0)
        found.append(TimedScan(timed.stamp_ns * 1e-9, reading_of(timed.message, Scan, scanners[number].message)))
    return found


def _grid(run: RunMessages) -> OccupancyGrid | None:
    """Return the map that the run was localized in; None where it has none, or the recording lacks it."""
    try:
        return maps_of(Context(run.with_files(), "metrics")).grid
    except DynpfError:
        return None
