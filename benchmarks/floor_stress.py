"""Laser logs made harder: odometry that jitters or slips, short scanners, changed maps, a corridor of alcoves."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
from dynpf_formats.importers import log as imported
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.recording.attachments import files_of
from dynpf_protocol.messages import LaserScan, OdometryPose, RobotState, Scanner, planar_pose, timestamp
from dynpf_systems.rooms.studies.laser_logs import Record

from dynpf.maps.map_server import decode
from dynpf.maps.occupancy import FREE, OCCUPIED, OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.se2 import compose, relative

Random = np.random.Generator
SLIPS = 4
FURNITURE_M = 2.0  # what is smaller on the map is furniture, not a wall


class Trial(NamedTuple):
    """What the filter gets: records, and the map."""

    records: Sequence[Record]
    grid: OccupancyGrid


def grid_of(files: Mapping[str, bytes]) -> OccupancyGrid:
    """Return the map in a log's attachments."""
    name = next(name for name in files if name.endswith(".yaml"))
    return decode(files[name].decode(), lambda path: files[path], name)


def clean(trial: Trial, random: Random) -> Trial:  # noqa: ARG001
    """Return the trial as it is."""
    return trial


def jitter(trial: Trial, random: Random) -> Trial:
    """Return odometry at 20 Hz, each pose 5 mm (sigma) beside its place."""
    records: list[Record] = []
    held: list[Record] = []
    last: tuple[np.ndarray, int] | None = None
    for record in trial.records:
        if isinstance(record.message, OdometryPose):
            held.append(record)
            continue
        if held and last is None:
            records += held
            last, held = (_pose(held[-1]), record.stamp_ns), []
        elif held and last is not None:
            poses = [_pose(one) for one in held]
            start, since = last
            count = min(max(round((record.stamp_ns - since) * 2e-8), 1), 400)
            knots = [start, *poses]
            for step in range(1, count + 1):
                at = step / count * (len(knots) - 1)
                low = min(int(at), len(knots) - 2)
                turn = math.remainder(knots[low + 1][2] - knots[low][2], 2.0 * math.pi)
                here = knots[low] + (at - low) * np.array([*(knots[low + 1] - knots[low])[:2], turn])
                here = compose(here, np.array([0.0, random.normal(0.0, 0.005), 0.0]))
                records.append(held[0]._replace(stamp_ns=record.stamp_ns, message=_odometry(here)))
            last, held = (poses[-1], record.stamp_ns), []
        records.append(record)
    return trial._replace(records=records)


def slips(trial: Trial, random: Random) -> Trial:
    """Return odometry whose wheels slip: now and then it reports 0.3 m and 20 degrees that were not driven."""
    odometry = [index for index, record in enumerate(trial.records) if isinstance(record.message, OdometryPose)]
    where = set(random.choice(odometry[len(odometry) // 10 :], SLIPS, replace=False).tolist())
    records, last, shown = [], None, np.zeros(3)
    for index, record in enumerate(trial.records):
        if isinstance(record.message, OdometryPose):
            pose = _pose(record)
            shown = pose if last is None else compose(shown, relative(last, pose))
            if index in where:
                shown = compose(shown, np.array([0.3, 0.0, math.radians(20.0) * random.choice([-1.0, 1.0])]))
            last = pose
            records.append(record._replace(message=_odometry(shown)))
            continue
        records.append(record)
    return trial._replace(records=records)


def cut(range_max: float) -> Callable[[Trial, Random], Trial]:
    """Return a change that makes the scanner see no farther."""

    def change(trial: Trial, random: Random) -> Trial:  # noqa: ARG001
        return trial._replace(records=[_seeing(record, range_max) for record in trial.records])

    return change


def beams_30(trial: Trial, random: Random) -> Trial:  # noqa: ARG001
    """Return scans of thirty beams."""
    return trial._replace(records=[_thinned(record, 30) for record in trial.records])


def furniture(trial: Trial, random: Random) -> Trial:
    """Return the map with a third of its small things moved by half a metre, or taken away."""
    grid = trial.grid
    cells = grid.cells.copy()
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(grid.occupied.astype(np.uint8), connectivity=8)
    small = [k for k in range(1, count) if max(boxes[k][2], boxes[k][3]) * grid.resolution <= FURNITURE_M]
    shift = round(0.5 / grid.resolution)
    moved = []
    for label in random.choice(small, len(small) // 3, replace=False).tolist():
        row, column = np.nonzero(labels == label)
        cells[row, column] = FREE
        if random.random() < 0.5:
            down, right = random.choice([(-1, 0), (1, 0), (0, -1), (0, 1)]) * shift
            moved.append((row + down, column + right))
    for row, column in moved:
        inside = (row >= 0) & (row < cells.shape[0]) & (column >= 0) & (column < cells.shape[1])
        cells[row[inside], column[inside]] = OCCUPIED
    return trial._replace(grid=OccupancyGrid(cells, grid.resolution, grid.origin))


def half_map(trial: Trial, random: Random) -> Trial:  # noqa: ARG001
    """Return the map that the first half of the records draws."""
    scans = [record for record in trial.records if record.truth is not None]
    files = files_of(drawn_map(lambda: placed(scans[: len(scans) // 2]), 0.05, "map"))
    return trial._replace(grid=grid_of(files))


def placed(scans: Sequence[Record]) -> Iterator[imported.Record]:
    """Yield the true pose and the scan of each record."""
    for record in scans:
        assert record.truth is not None
        x, y, theta = record.truth
        yield imported.Record("log/truth", record.stamp_ns, RobotState(x=x, y=y, theta=theta, v=0.0, w=0.0))
        yield imported.Record(record.topic, record.stamp_ns, record.message)


def alcoves(random: Random) -> Trial:
    """Return a drive along a corridor of 36 m with an alcove every 3 m on both sides, past things that no map has.

    The scanner sees 5.6 m, over 180 degrees; odometry errs by 3 % and 0.002 rad a step.
    """
    size, cell = (840, 160), 0.05
    solid = np.ones((size[1], size[0]), dtype=bool)
    solid[56:104, 20:820] = False  # 2.4 m wide
    for start in range(60, 800, 60):
        solid[40:56, start : start + 24] = False
        solid[104:120, start : start + 24] = False
    world = solid.copy()
    for _ in range(14):
        column, row = random.integers(60, 780), random.choice([58, 96])
        world[row : row + 6, column : column + 8] = True
    rays = RayCaster(OccupancyGrid.from_bools(world, cell))
    pose, odometry = np.array([2.0, 4.0, 0.0]), np.zeros(3)
    angles = np.linspace(-math.pi / 2, math.pi / 2, 181)
    scanner, records = Scanner(range_min=0.05, range_max=5.6), []
    for k in range(420):
        way = 1.0 if k < 160 or k >= 190 else 0.0
        turn = (
            math.pi / 30 if 160 <= k < 190 else -0.1 * math.remainder(pose[2] - (0.0 if k < 160 else math.pi), math.tau)
        )
        step = np.array([0.2 * way, 0.0, turn - 0.05 * (pose[1] - 4.0) * math.cos(pose[2]) * way])
        pose = compose(pose, step)
        odometry = compose(
            odometry, step * (1.0, 1.0, 1.0) + (0.006 * way * random.normal(1.0), 0.0, random.normal(0.0, 0.002))
        )
        stamp = (k + 1) * 10**8
        ranges = rays.ranges(np.full(181, pose[0]), np.full(181, pose[1]), angles + pose[2], 5.6)
        ranges = np.minimum(ranges + random.normal(0.0, 0.01, 181), 5.6)
        records.append(Record(2 * k, "log/odometry_pose", stamp, _odometry(odometry), None))
        scan = LaserScan(
            timestamp=timestamp(stamp),
            frame_id="robot",
            pose=planar_pose(0.0, 0.0, 0.0),
            start_angle=float(angles[0]),
            end_angle=float(angles[-1]),
            ranges=tuple(ranges.tolist()),
        )
        records.append(Record(2 * k + 1, "log/scan", stamp, scan, tuple(pose.tolist()), scanner))
    return Trial(records, OccupancyGrid.from_bools(solid, cell))


STRESSES: Mapping[str, Callable[[Trial, Random], Trial]] = {
    "clean": clean,
    "jitter": jitter,
    "slips": slips,
    "cut 4 m": cut(4.0),
    "cut 5.6 m": cut(5.6),
    "furniture": furniture,
    "half map": half_map,
    "30 beams": beams_30,
}


def _pose(record: Record) -> np.ndarray:
    assert isinstance(record.message, OdometryPose)
    return np.array([record.message.x, record.message.y, record.message.theta])


def _odometry(pose: np.ndarray) -> OdometryPose:
    x, y, theta = pose.tolist()
    return OdometryPose(x=x, y=y, theta=theta)


def _seeing(record: Record, range_max: float) -> Record:
    if not isinstance(record.message, LaserScan) or record.scanner is None:
        return record
    ranges = tuple(min(length, range_max) for length in record.message.ranges)
    scanner = msgspec.structs.replace(record.scanner, range_max=min(record.scanner.range_max, range_max))
    return record._replace(message=msgspec.structs.replace(record.message, ranges=ranges), scanner=scanner)


def _thinned(record: Record, beams: int) -> Record:
    scan = record.message
    if not isinstance(scan, LaserScan):
        return record
    every = max(len(scan.ranges) // beams, 1)
    kept = scan.ranges[::every]
    step = (scan.end_angle - scan.start_angle) / (len(scan.ranges) - 1)
    end = scan.start_angle + step * every * (len(kept) - 1)
    return record._replace(message=msgspec.structs.replace(scan, ranges=kept, end_angle=end))
