"""Importer of CARMEN logs: laser scans, odometry, and the corrected poses of a corrected log.

A log is lines of text: PARAM name value; ODOM x y theta v w acceleration; FLASER n ranges, laser pose, odometry pose;
ROBOTLASER1 with the scanner's geometry, ranges, remissions, laser pose, robot pose; TRUEPOS true pose, odometry pose;
each but PARAM ending in time, host, logger's time. The file's order is the order of events: the logger's clock jumps
back and forth between processes, so stamps are kept but records are not sorted by them.

A log that a mapper has corrected (GMapping, vasco) holds the corrected pose in its laser lines. Its ODOM lines restart
at that pose after every scan: the first after a scan repeats it, with a meaningless time (0, or whatever was in
memory), and is no record. Raw odometry is the chain of the increments between the other lines.
"""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from dynpf_protocol.messages import OdometryPose, RobotState

from dynpf.portable import hypot
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.poses import Pose, compose, inverse, relative, wrapped
from dynpf_formats.importers.scans import normalized_scan, scanner_record, without_repeated_scanners
from dynpf_formats.importers.text import finite_number, lines_of, seconds_to_ns, whole_number
from dynpf_formats.recording.header import Attachment

__all__ = ["import_carmen"]

Numbered = Iterable[tuple[int, str]]

LASERS = ("ROBOTLASER1", "FLASER")  # the more detailed one first: loggers write both for the same scan
NO_RETURN_M = 80.0  # a SICK scanner gives errors and missing returns as codes from 80 m on
DEPARTED_M, DEPARTED_RAD = 0.5, 0.3  # a laser line's pose that far from odometry has been corrected
PARAMS = {"robot_frontlaser_offset": "offset", "robot_front_laser_max": "range_max"}

BAD_LINE = "lines that cannot be read"


class _Odom(NamedTuple):
    pose: Pose
    time: str


class _Laser(NamedTuple):
    ranges: list[float]
    span: tuple[float, float]  # rad, first and last beam
    range_max: float | None  # m; None: the line does not give it
    laser: Pose
    robot: Pose  # FLASER calls it the odometry's
    time: str


class _Survey(NamedTuple):
    """What has to be known of a log before its first record can be made."""

    laser: str  # the kind of laser lines that are used
    offset: float  # m, of the front laser before the robot's centre
    range_max: float  # m, of FLASER lines
    odometry: bool  # whether there are ODOM lines
    restarts: bool  # whether odometry restarts after each scan
    corrected: bool  # whether the laser lines hold corrected poses
    apart: bool  # whether FLASER lines hold the corrected pose in one of their poses and raw odometry in the other
    backwards: int  # lines that are earlier than the one before them


def import_carmen(
    path: Path, *, range_max: float | None = None, attachments: tuple[Attachment, ...] = ()
) -> ImportedLog:
    """Return the log in a file, plain or compressed.

    ``range_max`` in metres: larger or equal ranges are no return; by default it is that of the line, else that of the
    log's parameters, else 80 m. Unreadable lines are left out and counted. Raises ImportFailedError if the file is no
    CARMEN log.
    """
    survey = _survey(path, range_max)
    losses = Losses()
    settings = {
        "laser": survey.laser,
        "odometry": "ODOM" if survey.odometry else survey.laser,
        "odometry_restored": survey.restarts,
        "truth": f"corrected poses of {survey.laser}" if survey.corrected else "TRUEPOS, if any",
        "laser_offset_m": survey.offset,
        "range_max_m": survey.range_max,
        "clock_backwards": survey.backwards,
    }
    records = without_repeated_scanners(_records(path, survey, range_max, losses))
    return ImportedLog(path.name, "carmen", settings, records, losses, attachments)


def _survey(path: Path, range_max: float | None) -> _Survey:
    params: dict[str, float] = {}
    counts = dict.fromkeys((*LASERS, "ODOM"), 0)
    departed = dict.fromkeys(LASERS, False)
    odom: Pose | None = None
    jumped: Pose | None = None  # the last laser line's pose, if it is not where odometry was
    jumps = repeated = 0
    apart = has_true_poses = False
    backwards, newest_ns = 0, 0
    for _, line in lines_of(path):
        kind, _, rest = line.partition(" ")
        fields = rest.split()
        if kind == "PARAM" and len(fields) > 1 and fields[0] in PARAMS:
            _take_param(params, PARAMS[fields[0]], fields[1])
        has_true_poses = has_true_poses or kind == "TRUEPOS"
        try:
            if kind == "ODOM":
                found = _odom(fields)
                odom, time = found.pose, found.time
                jumps, repeated = jumps + (jumped is not None), repeated + (jumped == odom)
                if jumped == odom:
                    jumped = None
                    continue
                jumped = None
            elif kind in LASERS:
                laser = _laser(kind, fields)
                time = laser.time
                jumped = laser.robot if odom is not None and odom != laser.robot else None
                away = odom is not None and _far(odom, laser.robot)
                apart |= kind == "FLASER" and _far(laser.laser, laser.robot)
                departed[kind] |= away or apart
            else:
                continue
            stamp_ns = seconds_to_ns(time)
        except ValueError:
            continue  # counted when the records are read
        counts[kind] += 1
        backwards, newest_ns = backwards + (stamp_ns < newest_ns), stamp_ns
    chosen = next((kind for kind in LASERS if counts[kind]), None)
    if chosen is None:
        raise ImportFailedError(f"{path}: no FLASER or ROBOTLASER1 line that can be read; expected a CARMEN log")
    restarts = repeated > jumps / 2
    return _Survey(
        laser=chosen,
        offset=params.get("offset", 0.0),
        range_max=range_max or params.get("range_max", NO_RETURN_M),
        odometry=counts["ODOM"] > 0,
        restarts=restarts,
        corrected=restarts or (departed[chosen] and not has_true_poses),  # beside true poses, the rest is odometry
        apart=apart and chosen == "FLASER",
        backwards=backwards,
    )


def _take_param(params: dict[str, float], name: str, text: str) -> None:
    try:
        value = float(text)
    except ValueError:
        return
    if math.isfinite(value) and (name != "range_max" or value > 0.0):
        params[name] = value


def _far(a: Pose, b: Pose) -> bool:
    return hypot(a[0] - b[0], a[1] - b[1]) > DEPARTED_M or abs(wrapped(a[2] - b[2])) > DEPARTED_RAD


class _Chain:
    """Raw odometry from poses that restart."""

    def __init__(self) -> None:
        self._raw: Pose | None = None
        self._anchors: tuple[Pose, Pose] | None = None  # a pose of the file, and of raw odometry at that moment

    def restart(self, pose: Pose) -> None:
        """Let ``pose`` of the file be the newest pose of raw odometry."""
        self._raw = self._raw or pose
        self._anchors = pose, self._raw

    def follow(self, pose: Pose) -> Pose:
        """Return a pose of the file as raw odometry."""
        if self._anchors is None:
            self._raw = (pose[0], pose[1], wrapped(pose[2]))
        else:
            start, raw = self._anchors
            self._raw = compose(raw, relative(start, pose))
        return self._raw


def _records(path: Path, survey: _Survey, range_max: float | None, losses: Losses) -> Iterator[Record]:
    chain = _Chain()
    restart: Pose | None = None  # where a corrected log's next ODOM line starts
    for number, line in lines_of(path):
        kind, _, rest = line.partition(" ")
        where = f"{path.name}:{number}"
        kind = kind.strip()
        if not kind or kind.startswith("#") or kind == "PARAM":
            continue
        try:
            if kind == "ODOM":
                odom = _odom(rest.split())
                repeats, restart = restart == odom.pose, None
                if repeats:
                    chain.restart(odom.pose)
                else:
                    yield _odometry(seconds_to_ns(odom.time), chain.follow(odom.pose))
            elif kind == survey.laser:
                laser = _laser(kind, rest.split())
                restart = laser.robot if survey.restarts else None
                yield from _laser_records(laser, survey, range_max, losses)
            elif kind == "TRUEPOS" and not survey.corrected:
                pose, time = _true_pose(rest.split())
                yield _truth(seconds_to_ns(time), pose)
            else:
                losses.add(f"{kind[:30]} lines" + (", the same scans again" if kind in LASERS else ""), where)
        except ValueError as error:
            losses.add(BAD_LINE, f"{where}: {error}")


def _laser_records(laser: _Laser, survey: _Survey, range_max: float | None, losses: Losses) -> Iterator[Record]:
    stamp_ns = seconds_to_ns(laser.time)
    mount: Pose = (survey.offset, 0.0, 0.0) if survey.laser == "FLASER" else relative(laser.robot, laser.laser)
    if survey.corrected:
        # Mappers that write one pose as both have corrected the robot's.
        yield _truth(stamp_ns, compose(laser.laser, inverse(mount)) if survey.apart else laser.robot)
    if not survey.odometry and (survey.apart or not survey.corrected):
        x, y, theta = laser.robot
        yield _odometry(stamp_ns, (x, y, wrapped(theta)))
    limits = (0.0, range_max or laser.range_max or survey.range_max)
    scan = normalized_scan(stamp_ns, mount, laser.span, laser.ranges, limits, losses=losses)
    if scan is not None:
        yield scanner_record(stamp_ns, limits)
        yield Record("log/scan", stamp_ns, scan)


def _truth(stamp_ns: int, pose: Pose) -> Record:
    x, y, theta = pose
    return Record("log/truth", stamp_ns, RobotState(x=x, y=y, theta=theta))


def _odometry(stamp_ns: int, pose: Pose) -> Record:
    x, y, theta = pose
    return Record("log/odometry_pose", stamp_ns, OdometryPose(x=x, y=y, theta=theta))


def _odom(fields: list[str]) -> _Odom:
    if len(fields) < 9:
        raise ValueError(f"{len(fields)} values in an ODOM line; expected 9")
    return _Odom(_pose(fields[:3]), fields[6])


def _true_pose(fields: list[str]) -> tuple[Pose, str]:
    if len(fields) < 9:
        raise ValueError(f"{len(fields)} values in a TRUEPOS line; expected 9")
    return _pose(fields[:3]), fields[6]


def _laser(kind: str, fields: list[str]) -> _Laser:
    return _front_laser(fields) if kind == "FLASER" else _robot_laser(fields)


def _front_laser(fields: list[str]) -> _Laser:
    """Parse a FLASER line. It has no angles: beams cover 180 degrees, an even number without the last (-90 .. 89)."""
    count = _count(fields, 0)
    _expect(fields, count + 10)
    ranges = _ranges(fields[1 : count + 1])
    rest = fields[count + 1 :]
    width = math.radians(100.0) if count == 401 else math.pi  # the scanner's mode of a quarter of a degree
    steps = count if count % 2 == 0 else count - 1
    end = -width / 2 + (width * (count - 1) / steps if steps else 0.0)
    seconds_to_ns(rest[6])
    return _Laser(ranges, (-width / 2, end), None, _pose(rest[:3]), _pose(rest[3:6]), rest[6])


def _robot_laser(fields: list[str]) -> _Laser:
    count = _count(fields, 7)
    _expect(fields, count + 9)
    start, _, step, range_max = (finite_number(text, "geometry of the laser") for text in fields[1:5])
    ranges = _ranges(fields[8 : count + 8])
    remissions = _count(fields, count + 8)
    _expect(fields, count + remissions + 23)
    rest = fields[count + 9 + remissions :]
    seconds_to_ns(rest[11])
    span = (start, start + step * (count - 1))
    return _Laser(ranges, span, range_max if range_max > 0.0 else None, _pose(rest[:3]), _pose(rest[3:6]), rest[11])


def _count(fields: list[str], index: int) -> int:
    _expect(fields, index + 1)
    return whole_number(fields[index], "number of readings")


def _expect(fields: list[str], count: int) -> None:
    if len(fields) < count:
        raise ValueError(f"{len(fields)} values in a line of {count}: it is cut off")


def _ranges(fields: list[str]) -> list[float]:
    try:
        return [float(text) for text in fields]
    except ValueError as error:
        raise ValueError(f"range: {error}") from None


def _pose(fields: list[str]) -> Pose:
    x, y, theta = (finite_number(text, name) for text, name in zip(fields, ("x", "y", "theta"), strict=True))
    return x, y, theta
