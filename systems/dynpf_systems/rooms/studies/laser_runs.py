"""Runs on a laser log for studies: from any record on, and with the robot kidnapped."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.drive import drive
from dynpf_protocol.messages import Estimate, LaserScan, Message, OdometryPose
from dynpf_runtime.node import Received
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import LogContent
from dynpf_services.scenario.schema import Scenario

from dynpf.filters.start import KnownStart, UniformStart
from dynpf.se2 import compose, relative, wrap_angle
from dynpf.types import FloatArray
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.studies.laser_logs import LaserLog, Record, encoded

__all__ = ["Moment", "UpdateCount", "kidnapped", "play", "scenario_for"]

_TOPICS = ("sensors/odometry_pose", "sensors/scan", "estimator/state")


class Moment(NamedTuple):
    """The estimate after a scan, and the truth."""

    true: FloatArray  # (3,)
    estimate: FloatArray | None  # (3,); None before the first
    covariance: FloatArray  # (3, 3)
    status: str
    updates: int  # scans that the filter has taken in; see UpdateCount

    @property
    def errors(self) -> tuple[float, float]:
        """Return the distance (m) and the angle (rad) between truth and estimate; infinite without estimate."""
        if self.estimate is None:
            return np.inf, np.inf
        away = self.estimate - self.true
        return float(np.hypot(away[0], away[1])), float(abs(wrap_angle(away[2])))


class UpdateCount:
    """Counts a filter's updates by scans, from the messages of its sensors.

    A scan is an update if it is the first, or if the robot has moved by the scenario's ``min_travel`` or ``min_turn``
    since the last update. A start chosen by the first scan uses up that scan and does not count.
    """

    def __init__(self, config: LocalizationConfig) -> None:
        self._least = (config.min_travel, config.min_turn)
        self._starts_by_scan = not isinstance(config.start, KnownStart | UniformStart)
        self._since: tuple[float, float] | None = None
        self._pose: FloatArray | None = None
        self.updates = 0

    def see(self, message: Message) -> None:
        """Count a message of the sensors; messages have to come in their order in the log."""
        match message:
            case OdometryPose(x=x, y=y, theta=theta):
                self._move(np.array([x, y, theta]))
            case LaserScan():
                self._scan()

    def _move(self, pose: FloatArray) -> None:
        if self._pose is not None and self._since is not None:
            step = relative(self._pose, pose)
            travel, turn = self._since
            self._since = travel + math.hypot(step[0], step[1]), turn + abs(float(step[2]))
        self._pose = pose

    def _scan(self) -> None:
        first = self._since is None
        travel, turn = self._since or (math.inf, math.inf)
        if travel >= self._least[0] or turn >= self._least[1]:
            self.updates += not (first and self._starts_by_scan)
            self._since = (0.0, 0.0)


def scenario_for(log: LaserLog, name: str, seed: int, overrides: Sequence[str] = ()) -> Scenario:
    """Return the scenario ``name`` with the facts of a log."""
    return load_scenario(name, overrides=overrides, seed=seed, log=log.facts)


def kidnapped(records: Sequence[Record], at: int, distance: float) -> list[Record]:
    """Return the records without those from scan ``at`` until the robot is farther than ``distance`` from there.

    The first record kept after the gap is at index ``at``. Odometry continues from its last pose before the gap, so
    that it does not contain the displacement. Raises ValueError where the true pose at the scan is unknown, or the
    robot never gets so far.
    """
    start = records[at].truth
    if start is None:
        raise ValueError(f"record {at} is not a scan with a known true pose")
    far = (
        index
        for index, record in enumerate(records[at:], at)
        if record.truth is not None and math.dist(record.truth[:2], start[:2]) > distance
    )
    after = next(far, None)
    if after is None:
        raise ValueError(f"the robot does not get {distance} m away from record {at}")
    last, first = (_newest_odometry(records[:end]) for end in (at, after))
    rest = records[after:]
    if last is not None and first is not None:
        rest = [_carried(record, last, first) for record in rest]
    return [*records[:at], *rest]


def play(
    scenario: Scenario,
    records: Sequence[Record],
    *,
    enough: Callable[[int, int], bool] = lambda _scans, _updates: False,
) -> list[Moment]:
    """Run a scenario on the records of a log and return the estimate after each scan with a known true pose.

    The run ends early once ``enough(scans, updates)`` holds for the numbers of such scans and of updates.
    """
    config = scenario.estimator
    assert isinstance(config, LocalizationConfig)
    truths = {record.stamp_ns: np.array(record.truth) for record in records if record.truth is not None}
    moments: list[Moment] = []
    count, scan_ns = UpdateCount(config), -1

    def stopped(received: Received) -> bool:
        """Keep the estimate after each scan; return whether the run may end."""
        nonlocal scan_ns
        count.see(received.message)
        if isinstance(received.message, LaserScan):
            scan_ns = received.stamp_ns
        if isinstance(received.message, Estimate) and received.stamp_ns == scan_ns and scan_ns in truths:
            if not (moments and enough(len(moments), moments[-1].updates)):
                moments.append(_moment(truths[scan_ns], received.message, count.updates))
            scan_ns = -1
        return bool(moments) and enough(len(moments), moments[-1].updates)

    drive(scenario, _TOPICS, LogContent(encoded(records)), stopped=stopped)
    return moments


def _moment(true: FloatArray, estimate: Estimate, updates: int) -> Moment:
    pose = np.array([estimate.x, estimate.y, estimate.theta])
    covariance = np.array(estimate.covariance).reshape(3, 3)
    status = estimate.health.status if estimate.health else ""
    return Moment(true, pose, covariance, status, updates)


def _newest_odometry(records: Sequence[Record]) -> FloatArray | None:
    messages = (record.message for record in reversed(records))
    return next((_pose(message) for message in messages if isinstance(message, OdometryPose)), None)


def _pose(message: OdometryPose) -> FloatArray:
    return np.array([message.x, message.y, message.theta])


def _carried(record: Record, last: FloatArray, first: FloatArray) -> Record:
    """Return a record after a kidnapping: odometry is moved so that its pose ``first`` becomes ``last``."""
    if not isinstance(record.message, OdometryPose):
        return record
    x, y, theta = compose(last, relative(first, _pose(record.message))).tolist()
    return record._replace(message=msgspec.structs.replace(record.message, x=x, y=y, theta=theta))
