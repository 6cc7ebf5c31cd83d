"""The robots of a run: true, estimated and dead-reckoned paths, particles, and readings."""

import math
from typing import NamedTuple

import numpy as np
from dynpf_protocol.messages import (
    LandmarkReadings,
    LaserScan,
    LineReadings,
    Message,
    Odometry,
    OdometryPose,
    PoseInFrame,
    PosesInFrame,
    PositionFix,
    RobotState,
    Scanner,
    heading,
)

from dynpf.metrics.trajectory import dead_reckoning
from dynpf.portable import sincos
from dynpf.types import FloatArray
from dynpf_experiments.pictures.drawing import Track
from dynpf_experiments.pictures.source import RunSource, robot_of

__all__ = ["Clouds", "Readings", "clouds_of", "columns_of", "greatest_range", "readings_of", "scan_points", "tracks_of"]

TRUTHS = ("truth/robot", "log/truth")
RECKONED = "/dead_reckoning"
MOST_BEAMS = 90
MOST_INTEGRATED = 20_000
"""Odometry records that are integrated where no node tells the path by odometry alone."""


class Clouds(NamedTuple):
    """Particles of a node: sets of points (2, M), at their times (T,); ``told`` is how many were recorded."""

    node: str
    seconds: FloatArray
    points: list[FloatArray]
    told: int


class Readings(NamedTuple):
    """Readings of a sensor, as points (2, M) seen from the robot: of a ``scan``, of ``rays`` to what was sighted, or
    ends of ``segments``; or a ``fix``, a position in the map. ``told`` is how many were recorded.
    """

    topic: str
    robot: str
    form: str
    seconds: FloatArray
    points: list[FloatArray]
    told: int


def tracks_of(source: RunSource) -> list[Track]:
    """Return the true paths of all robots, and those by odometry alone, one for each robot."""
    found = [_truth(source, topic) for topic in source.carrying(RobotState) if topic.endswith(TRUTHS)]
    reckoned: dict[str, Track] = {}
    for topic in source.carrying(PoseInFrame):
        robot = robot_of(topic.removesuffix(RECKONED))
        if topic.endswith(RECKONED) and robot not in reckoned:
            reckoned[robot] = _reckoned(source, topic, robot)
    for topic in source.carrying(OdometryPose, Odometry):
        robot = topic.rpartition("/")[0].rpartition("/")[0]
        if robot not in reckoned:
            truth = next((track for track in found if track.robot == robot and track.role == "truth"), None)
            reckoned[robot] = _integrated(source, topic, robot, truth)
    return [track for track in (*found, *reckoned.values()) if track.seconds.size]


def clouds_of(source: RunSource, per_metre: float) -> list[Clouds]:
    """Return the particles of all nodes that show them."""
    topics = [topic for topic in source.carrying(PosesInFrame) if topic.endswith("/particles")]
    most = source.budget.clouds // max(1, len(topics))
    found = []
    for topic in topics:
        known = [(at, message) for at, message in source.messages(topic, most) if isinstance(message, PosesInFrame)]
        points = [
            per_metre * np.array([(pose.position.x, pose.position.y) for pose in message.poses]).reshape(-1, 2).T
            for _, message in known
        ]
        node = topic.rpartition("/")[0]
        found.append(Clouds(node, np.array([at for at, _ in known]), points, len(source.records(topic))))
    return found


def readings_of(source: RunSource) -> list[Readings]:
    """Return the readings of all sensors that dynpf knows; of a log's records those that sensors did not pass on."""
    topics = source.carrying(LaserScan, LandmarkReadings, LineReadings, PositionFix)
    passed_on = {topic for topic in topics if "sensors/" in topic}
    topics = [topic for topic in topics if topic.replace("log/", "sensors/") not in passed_on - {topic}]
    most = source.budget.readings // max(1, len(topics))
    return [_readings(source, topic, most) for topic in topics]


def _truth(source: RunSource, topic: str) -> Track:
    ends = next(end for end in TRUTHS if topic.endswith(end))
    robot = topic.removesuffix(ends).removesuffix("/")
    known = [(at, m) for at, m in source.messages(topic) if isinstance(m, RobotState)]
    states = [(at, m.x, m.y, m.theta if m.heading_valid else math.nan) for at, m in known]
    return Track("truth", "truth", robot, *columns_of(states))


def _reckoned(source: RunSource, topic: str, robot: str) -> Track:
    known = [(at, m.pose) for at, m in source.messages(topic) if isinstance(m, PoseInFrame)]
    rows = [(at, pose.position.x, pose.position.y, heading(pose.orientation)) for at, pose in known]
    return Track("odometry", "odometry", robot, *columns_of(rows))


def _integrated(source: RunSource, topic: str, robot: str, truth: Track | None) -> Track:
    """Return the path by odometry records, from the first true pose after the first of them on; else from 0."""
    known = list(source.messages(topic, MOST_INTEGRATED))
    if len(known) < len(source.records(topic)):
        return Track("odometry", "odometry", robot, *columns_of([]))
    start = (0.0, 0.0, 0.0)
    if truth is not None and known and truth.seconds[-1] >= known[0][0]:
        after = np.flatnonzero((truth.seconds >= known[0][0]) & np.isfinite(truth.poses[2]))
        first = int(after[0]) if after.size else 0
        start = tuple(np.nan_to_num(truth.poses[:, first]).tolist())
        known = [(at, message) for at, message in known if at >= truth.seconds[first]]
    poses = [(at, m.x, m.y, m.theta) for at, m in known if isinstance(m, OdometryPose)]
    if poses:
        return Track("odometry", "odometry", robot, *_carried(*columns_of(poses), start))
    twists = [(at, m.v, m.w, 0.0) for at, m in known if isinstance(m, Odometry)]
    seconds, rows = columns_of(twists)
    if not seconds.size:
        return Track("odometry", "odometry", robot, seconds, rows)
    return Track("odometry", "odometry", robot, *dead_reckoning(seconds, rows[:2], start))


def _carried(seconds: FloatArray, poses: FloatArray, start: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return poses of a frame of their own moved so that the first is ``start``."""
    turn = start[2] - float(poses[2, 0])
    sine, cosine = (float(value) for value in sincos(turn))
    x, y = poses[0] - poses[0, 0], poses[1] - poses[1, 0]
    moved = (start[0] + cosine * x - sine * y, start[1] + sine * x + cosine * y, poses[2] + turn)
    return seconds, np.stack(moved)


def columns_of(rows: list[tuple[float, float, float, float]]) -> tuple[FloatArray, FloatArray]:
    """Return times (T,) and poses (3, T)."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return table[:, 0], table[:, 1:].T


def _readings(source: RunSource, topic: str, most: int) -> Readings:
    node = topic.rpartition("/")[0]
    greatest = greatest_range(source, f"{node}/scanner")
    forms = {LaserScan: "scan", LandmarkReadings: "rays", LineReadings: "segments", PositionFix: "fix"}
    form = forms[source.recording.topics[topic].type]
    known = list(source.messages(topic, most))
    points = [_seen(message, greatest) for _, message in known]
    seconds = np.array([at for at, _ in known])
    return Readings(topic, robot_of(node), form, seconds, points, len(source.records(topic)))


def greatest_range(source: RunSource, topic: str) -> float:
    """Return what a scanner reads where a beam meets nothing, m, by what it says on a topic; infinity by default."""
    ranges = [m.range_max for _, m in source.messages(topic, 10) if isinstance(m, Scanner)]
    return min(ranges, default=math.inf)


def _seen(message: Message, greatest: float) -> FloatArray:
    """Return what a reading shows, as points (2, M) in the robot's frame, of a fix in the map's."""
    match message:
        case LaserScan():
            return scan_points(message, greatest, MOST_BEAMS)
        case LandmarkReadings(readings=readings):
            return _polar([(reading.range, reading.bearing) for reading in readings])
        case LineReadings(readings=readings):
            return _pieces([(line.rho, line.alpha, line.length) for line in readings])
        case PositionFix(x=x, y=y):
            return np.array([[x], [y]])
    return np.empty((2, 0))


def scan_points(scan: LaserScan, greatest: float, most: int | None = None) -> FloatArray:
    """Return the ends of at most ``most`` of a scan's beams as the robot sees them, (2, M); without those that met
    nothing."""
    beams = len(scan.ranges)
    step = (scan.end_angle - scan.start_angle) / max(1, beams - 1)
    stride = 1 if most is None else -(-beams // most)
    at, turn = scan.pose.position, heading(scan.pose.orientation)
    rows = [
        (scan.ranges[beam], scan.start_angle + beam * step + turn)
        for beam in range(0, beams, stride or 1)
        if 0.0 < scan.ranges[beam] < greatest
    ]
    return np.asarray(_polar(rows) + np.array([[at.x], [at.y]]))


def _polar(rows: list[tuple[float, float]]) -> FloatArray:
    table = np.array(rows, dtype=np.float64).reshape(-1, 2)
    sines, cosines = sincos(table[:, 1])
    return np.stack([table[:, 0] * cosines, table[:, 0] * sines])


def _pieces(rows: list[tuple[float, float, float]]) -> FloatArray:
    """Return the ends of pieces of wall, two after two, each centred at the foot of the robot's perpendicular."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    sines, cosines = sincos(table[:, 1])
    foot = table[:, 0] * np.stack([cosines, sines])
    along = 0.5 * table[:, 2] * np.stack([-sines, cosines])
    return np.stack([foot - along, foot + along], axis=2).reshape(2, -1)
