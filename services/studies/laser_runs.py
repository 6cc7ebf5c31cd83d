"""Runs of the estimator on a laser log for studies: from any place of it, and with the robot carried off; no bus."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from dynpf.se2 import FloatArray, compose, relative, wrap_angle
from protocol.codec import decode
from protocol.messages import Estimate, LaserScan, Message, OdometryPose, RobotState
from services.node import Node, Received, Step
from services.nodes import build_node
from services.played_log import PlayedLog
from services.scenario import LogFacts, load_scenario

__all__ = ["LaserLog", "Moment", "estimator_for", "kidnapped", "play", "read_laser_log"]


class Record(NamedTuple):
    """A message of a log, as its sensors give it."""

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

    @property
    def errors(self) -> tuple[float, float]:
        """Return the distance (m) and the angle (rad) between truth and estimate; infinite without estimate."""
        if self.estimate is None:
            return np.inf, np.inf
        away = self.estimate - self.true
        return float(np.hypot(away[0], away[1])), float(abs(wrap_angle(away[2])))


def read_laser_log(path: Path) -> LaserLog:
    """Return an imported log; raises what PlayedLog does.

    True poses are those of the reference at the stamps of the scans, linearly between its neighbours.
    """
    log = PlayedLog(path)
    messages = [(one.topic, one.stamp_ns, decode(one.topic, one.payload)) for one in log.records]
    known = {stamp: (m.x, m.y, m.theta) for _, stamp, m in messages if isinstance(m, RobotState)}
    stamps = np.array(sorted(known), dtype=np.int64)
    poses = np.array([known[stamp] for stamp in stamps.tolist()]).reshape(-1, 3)
    headings = np.unwrap(poses[:, 2])

    def truth(stamp: int) -> tuple[float, float, float] | None:
        if stamps.size == 0 or not stamps[0] <= stamp <= stamps[-1]:
            return None
        since = (stamps - stamps[0]).astype(float)
        x, y, theta = (float(np.interp(stamp - stamps[0], since, one)) for one in (*poses[:, :2].T, headings))
        return x, y, float(wrap_angle(theta))

    records = [
        Record(topic, stamp, message, truth(stamp) if isinstance(message, LaserScan) else None)
        for topic, stamp, message in messages
        if isinstance(message, LaserScan | OdometryPose)
    ]
    return LaserLog(path.stem, tuple(records), log.facts)


def estimator_for(log: LaserLog, scenario: str, seed: int, overrides: Sequence[str] = ()) -> Node:
    """Return the estimator of a scenario, before its first step, for a log."""
    return build_node(load_scenario(scenario, overrides=overrides, seed=seed, log=log.facts), "estimator")


def kidnapped(records: Sequence[Record], at: int, distance: float) -> tuple[list[Record], int] | None:
    """Return the records without those from scan ``at`` on until the robot is farther than ``distance`` from there.

    Also the first scan after that, as its place in what is returned; None where it never gets so far. Odometry goes on
    from where it was, so that nothing tells of the way.
    """
    place = records[at].truth
    assert place is not None
    after = next(
        (
            k
            for k, one in enumerate(records[at:], at)
            if one.truth is not None and np.hypot(one.truth[0] - place[0], one.truth[1] - place[1]) > distance
        ),
        None,
    )
    if after is None:
        return None
    before = list(records[:at])
    last = next((one.message for one in reversed(before) if isinstance(one.message, OdometryPose)), None)
    first = next((one.message for one in reversed(records[:after]) if isinstance(one.message, OdometryPose)), None)
    rest = records[after:]
    if isinstance(last, OdometryPose) and isinstance(first, OdometryPose):
        rest = [_carried(one, _pose(last), _pose(first)) for one in rest]
    return [*before, *rest], at


def play(node: Node, records: Sequence[Record]) -> list[Moment]:
    """Return what the estimator makes of each scan whose true pose is known."""
    moments, estimate = [], None
    for number, one in enumerate(records):
        received = Received(one.topic.replace("log/", "sensors/", 1), "sensors", "", number, one.stamp_ns, one.message)
        for output in node.step(Step(number, number, one.stamp_ns, (received,))).outputs:
            estimate = output.message if isinstance(output.message, Estimate) else estimate
        if one.truth is not None:
            moments.append(_moment(node, np.array(one.truth), estimate))
    return moments


def _moment(node: Node, true: FloatArray, estimate: Estimate | None) -> Moment:
    if estimate is None:
        return Moment(true, None, np.full((3, 3), np.nan), "", 0)
    belief = node.freeze()["belief"]
    pose = np.array([estimate.x, estimate.y, estimate.theta])
    covariance = np.array(estimate.covariance).reshape(3, 3)
    status = estimate.health.status if estimate.health else ""
    return Moment(true, pose, covariance, status, len(belief["weights"]) if "weights" in belief else 0)


def _pose(message: OdometryPose) -> FloatArray:
    return np.array([message.x, message.y, message.theta])


def _carried(record: Record, last: FloatArray, first: FloatArray) -> Record:
    """Return a record after the robot was carried off: odometry that was ``first`` then goes on from ``last``."""
    if not isinstance(record.message, OdometryPose):
        return record
    x, y, theta = compose(last, relative(first, _pose(record.message))).tolist()
    return record._replace(message=msgspec.structs.replace(record.message, x=x, y=y, theta=theta))
