"""Runs of the estimator on a laser log for studies: from any place of it, and with the robot carried off; no bus."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from dynpf_formats.importers import log as imported
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.importers.stream import LogStream
from dynpf_formats.recording.attachments import FOLDER
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import Estimate, LaserScan, Message, OdometryPose, RobotState
from dynpf_runtime.node import Node, Received, Step
from dynpf_services.scenario.build import build_node
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.schema import LogFacts

from dynpf.se2 import FloatArray, compose, relative, wrap_angle

__all__ = [
    "LaserLog",
    "Moment",
    "Record",
    "estimator_for",
    "imported_log",
    "kidnapped",
    "play",
    "read_laser_log",
    "split",
]


class Record(NamedTuple):
    """A message of a log, as its sensors give it, and its place among the messages."""

    number: int
    topic: str
    stamp_ns: int
    message: Message
    truth: tuple[float, float, float] | None  # of a scan; where the reference does not tell it, None


class LaserLog(NamedTuple):
    """Odometry and scans of an imported log, and what it brings to a scenario."""

    name: str
    records: tuple[Record, ...]
    facts: LogFacts

    @property
    def scans(self) -> list[int]:
        """Return which of the records are scans of which the true pose is known."""
        return [place for place, one in enumerate(self.records) if one.truth is not None]


class Moment(NamedTuple):
    """What the estimator made of a scan."""

    true: FloatArray  # (3,)
    estimate: FloatArray | None  # (3,); None before the first
    covariance: FloatArray  # (3, 3)
    status: str
    particles: int
    updates: int  # that the filter has made

    @property
    def errors(self) -> tuple[float, float]:
        """Return the distance (m) and the angle (rad) between truth and estimate; infinite without estimate."""
        if self.estimate is None:
            return np.inf, np.inf
        away = self.estimate - self.true
        return float(np.hypot(away[0], away[1])), float(abs(wrap_angle(away[2])))


def read_laser_log(path: Path) -> LaserLog:
    """Return an imported log; raises what PlayedLog does."""
    log = PlayedLog(path)
    messages = [(one.topic, one.stamp_ns, decode(one.topic, one.payload)) for one in log.records]
    return _laser_log(path.stem, messages, log.facts)


def imported_log(name: str, stream: LogStream) -> LaserLog:
    """Return a log as an importer gives it."""
    messages = [(one.topic, one.stamp_ns, one.message) for one in stream.records]
    files = {one.name.removeprefix(FOLDER): one.data for one in stream.attachments}
    facts = LogFacts("", [], {}, files, stream.settings.get("range_max_m"))
    return _laser_log(name, messages, facts)


def _laser_log(name: str, messages: Sequence[tuple[str, int, Message]], facts: LogFacts) -> LaserLog:
    """Return the log; true poses are the reference's at the stamps of the scans, linearly between its neighbours."""
    known = {stamp: (m.x, m.y, m.theta) for _, stamp, m in messages if isinstance(m, RobotState)}
    stamps = np.array(sorted(known), dtype=np.int64)
    poses = np.array([known[stamp] for stamp in stamps.tolist()]).reshape(-1, 3)
    since, headings = (stamps - stamps[:1]).astype(np.float64), np.unwrap(poses[:, 2])

    def truth(stamp: int) -> tuple[float, float, float] | None:
        if stamps.size == 0 or not stamps[0] <= stamp <= stamps[-1]:
            return None
        x, y, theta = (float(np.interp(stamp - stamps[0], since, one)) for one in (*poses[:, :2].T, headings))
        return x, y, float(wrap_angle(theta))

    records = [
        Record(number, topic, stamp, message, truth(stamp) if isinstance(message, LaserScan) else None)
        for number, (topic, stamp, message) in enumerate(messages)
        if isinstance(message, LaserScan | OdometryPose)
    ]
    return LaserLog(name, tuple(records), facts)


def split(log: LaserLog, resolution: float = 0.05) -> LaserLog:
    """Return the log with every second of its scans left out, and instead of its map one drawn from those alone.

    A map that was drawn from the very scans that are then compared with it flatters.
    """
    scans = log.scans
    drawn, rest = scans[::2], set(scans[1::2])

    def placed() -> Iterator[imported.Record]:
        for place in drawn:
            one = log.records[place]
            assert one.truth is not None
            x, y, theta = one.truth
            yield imported.Record("log/truth", one.stamp_ns, RobotState(x=x, y=y, theta=theta, v=0.0, w=0.0))
            yield imported.Record(one.topic, one.stamp_ns, one.message)

    records = tuple(
        one for place, one in enumerate(log.records) if isinstance(one.message, OdometryPose) or place in rest
    )
    files = {one.name.removeprefix(FOLDER): one.data for one in drawn_map(placed, resolution, "map")}
    return LaserLog(f"{log.name}-split", records, log.facts._replace(files=files))


def estimator_for(log: LaserLog, scenario: str, seed: int, overrides: Sequence[str] = ()) -> Node:
    """Return the estimator of a scenario, before its first step, for a log."""
    return build_node(load_scenario(scenario, overrides=overrides, seed=seed, log=log.facts), "estimator")


def kidnapped(records: Sequence[Record], at: int, distance: float) -> list[Record]:
    """Return the records without those from scan ``at`` on until the robot is farther than ``distance`` from there.

    The first of those that are left after it stands at place ``at``. Odometry goes on from where it was, so that
    nothing tells of the way. Raises ValueError where the true pose at the scan is unknown, or it never gets so far.
    """
    place = records[at].truth
    if place is None:
        raise ValueError(f"record {at} is no scan of which the true pose is known")
    far = (
        k
        for k, one in enumerate(records[at:], at)
        if one.truth is not None and math.dist(one.truth[:2], place[:2]) > distance
    )
    after = next(far, None)
    if after is None:
        raise ValueError(f"the robot does not get {distance} m away from record {at}")
    last, first = (_newest_odometry(records[:end]) for end in (at, after))
    rest = records[after:]
    if last is not None and first is not None:
        rest = [_carried(one, last, first) for one in rest]
    return [*records[:at], *rest]


def play(node: Node, records: Sequence[Record], *, most: int | None = None) -> list[Moment]:
    """Return what the estimator makes of each scan whose true pose is known, until it has made ``most`` updates."""
    moments: list[Moment] = []
    estimate = None
    for one in records:
        topic = one.topic.replace("log/", "sensors/", 1)
        received = Received(topic, "sensors", "", one.number, one.stamp_ns, one.message)
        for output in node.step(Step(one.number, one.number, one.stamp_ns, (received,))).outputs:
            estimate = output.message if isinstance(output.message, Estimate) else estimate
        if one.truth is not None:
            moments.append(_moment(node, np.array(one.truth), estimate))
            if most is not None and moments[-1].updates >= most:
                break
    return moments


def _moment(node: Node, true: FloatArray, estimate: Estimate | None) -> Moment:
    if estimate is None:
        return Moment(true, None, np.full((3, 3), np.nan), "", 0, 0)
    state = node.freeze()
    pose = np.array([estimate.x, estimate.y, estimate.theta])
    covariance = np.array(estimate.covariance).reshape(3, 3)
    status = estimate.health.status if estimate.health else ""
    updates = sum(state["outcomes"].values())
    return Moment(true, pose, covariance, status, len(state["belief"]["weights"]), updates)


def _newest_odometry(records: Sequence[Record]) -> FloatArray | None:
    messages = (one.message for one in reversed(records))
    return next((_pose(one) for one in messages if isinstance(one, OdometryPose)), None)


def _pose(message: OdometryPose) -> FloatArray:
    return np.array([message.x, message.y, message.theta])


def _carried(record: Record, last: FloatArray, first: FloatArray) -> Record:
    """Return a record after the robot was carried off: odometry that was ``first`` then goes on from ``last``."""
    if not isinstance(record.message, OdometryPose):
        return record
    x, y, theta = compose(last, relative(first, _pose(record.message))).tolist()
    return record._replace(message=msgspec.structs.replace(record.message, x=x, y=y, theta=theta))
