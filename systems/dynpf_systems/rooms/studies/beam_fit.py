"""Fit of the beam model to a recorded run: its measured ranges, against ray lengths from the true poses."""

from collections.abc import Iterable

import numpy as np
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import LaserScan, RobotState, Scanner
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.schema import Scenario

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.measurement.beam import BeamParams
from dynpf.measurement.beam_fit import BeamFit, fit_beam
from dynpf.se2 import compose
from dynpf.types import FloatArray, Floats
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.maps import open_maps

__all__ = ["fit_recording", "fit_scans"]

APART_NS = 500_000_000
"""Greatest interval between true poses that is interpolated."""


def fit_recording(recording: Recording) -> BeamFit:
    """Return the maximum-likelihood beam model of a run's scans, at the true poses in the run's map.

    The fit begins with the beam model of the run's estimator, if it has one, and keeps the parameters that are not
    fitted. Raises UsageError for a recording without scans, true poses or a grid map.
    """
    scenario = recorded_scenario(recording)
    grid = open_maps(scenario.map, None, lambda path: scenario.files[path.rpartition("/")[2]].data).grid
    if grid is None:
        raise UsageError(f"{recording.path}: its run had no map")
    estimator = scenario.estimator
    tables = estimator.measurement if isinstance(estimator, LocalizationConfig) else ()
    start = next((table for table in tables if isinstance(table, BeamParams)), BeamParams())
    stamps, poses = _truth(recording)
    taken = []
    for record in recording.messages("sensors/scan"):
        pose, message = _at(stamps, poses, record.stamp_ns), decode(record.topic, record.payload)
        if pose is not None and isinstance(message, LaserScan):
            angles = np.linspace(message.start_angle, message.end_angle, len(message.ranges))
            taken.append((pose, angles, np.array(message.ranges)))
    if not taken:
        raise UsageError(f"{recording.path}: holds no scans with true poses")
    return fit_scans(grid, taken, _range_max(recording, scenario), start)


def fit_scans(
    grid: OccupancyGrid, taken: Iterable[tuple[FloatArray, Floats, Floats]], range_max: float, start: BeamParams
) -> BeamFit:
    """Return the maximum-likelihood beam model of scans, each a robot's pose (3,), angles (B,) and ranges (B,)."""
    caster, sensor = RayCaster(grid), np.array([start.sensor_x, start.sensor_y, start.sensor_theta])
    readings, expected = [], []
    for pose, angles, ranges in taken:
        x, y, theta = compose(pose, sensor).tolist()
        from_x, from_y = (np.full(angles.size, coordinate, dtype=np.float32) for coordinate in (x, y))
        readings.append(ranges)
        expected.append(caster.ranges(from_x, from_y, (theta + angles).astype(np.float32), range_max))
    return fit_beam(np.concatenate(readings), np.concatenate(expected), range_max, start)


def _range_max(recording: Recording, scenario: Scenario) -> float:
    """Return the greatest range announced by the run's scanner, else that of its estimator."""
    scanners = [decode(record.topic, record.payload) for record in recording.messages("sensors/scanner")]
    if greatest := [scanner.range_max for scanner in scanners if isinstance(scanner, Scanner)]:
        return max(greatest)
    estimator = scenario.estimator
    if isinstance(estimator, LocalizationConfig) and estimator.scan_range_max is not None:
        return estimator.scan_range_max
    raise UsageError(f"{recording.path}: does not tell the scanner's greatest range")


def _truth(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return stamps (T,) in nanoseconds, ascending, and poses (3, T), headings unwrapped."""
    found = {}
    for topic in ("truth/robot", "log/truth"):
        for record in recording.messages(topic):
            message = decode(topic, record.payload)
            if isinstance(message, RobotState) and message.heading_valid:
                found[record.stamp_ns] = (message.x, message.y, message.theta)
    if not found:
        raise UsageError(f"{recording.path}: holds no true poses")
    poses = np.array([found[stamp] for stamp in sorted(found)]).T
    poses[2] = np.unwrap(poses[2])
    return np.array(sorted(found), dtype=np.float64), poses


def _at(stamps: FloatArray, poses: FloatArray, stamp_ns: int) -> FloatArray | None:
    after = int(np.searchsorted(stamps, stamp_ns))
    if after < stamps.size and stamps[after] == stamp_ns:
        return poses[:, after]
    if not 0 < after < stamps.size or stamps[after] - stamps[after - 1] > APART_NS:
        return None
    return np.array([np.interp(stamp_ns, stamps, row) for row in poses])
