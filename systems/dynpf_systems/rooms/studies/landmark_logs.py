"""Logs with landmarks for studies: read once in each process, cut into stretches, and run."""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.drive import drive
from dynpf_experiments.messages import RunMessages, of_type, seconds
from dynpf_formats.importers.log import Record
from dynpf_formats.importers.mrclam import import_mrclam, robots_in
from dynpf_formats.recording.attachments import landmarks_of
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Estimate, LandmarkReadings, RobotState
from dynpf_runtime.source import LogRecord
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import LogContent
from dynpf_services.scenario.schema import LogFacts
from numpy.typing import NDArray

from dynpf.metrics.trajectory import Trajectory, thin
from dynpf_systems.rooms.measures import reckoned_path

__all__ = [
    "LandmarkLog",
    "Run",
    "Stretch",
    "datasets",
    "every_second_landmark",
    "follow",
    "nearest_past",
    "opened",
    "stretches",
    "withheld",
]

SCENARIO = "landmark-mrclam"
SCORED_HZ = 10.0
_TOPICS = ("sensors/landmarks", "estimator/state", "estimator/dead_reckoning")
GAP_S = 0.5  # no stretch starts where the reference has a gap

Change = Callable[[Sequence[Record]], Sequence[Record]]


class LandmarkLog(NamedTuple):
    """Odometry and readings in order of time, the reference with the validity of its heading, and the landmarks."""

    name: str
    records: tuple[Record, ...]
    truth: Trajectory
    heading_valid: NDArray[np.bool_]
    landmarks: tuple[Landmark, ...]

    @property
    def start_ns(self) -> int:
        """The stamp of the first record, ns."""
        return self.records[0].stamp_ns


class Stretch(NamedTuple):
    """A part of a log, in seconds since its first record, and the pose at its beginning."""

    first: float
    last: float
    pose: tuple[float, float, float]


class Run(NamedTuple):
    """Results of an estimator on a stretch: scored estimates, the number of readings before each, and odometry alone.

    Odometry alone has no poses where the start was unknown.
    """

    estimate: Trajectory
    sigma: NDArray[np.float64]  # m, the greatest standard deviation of each position, as the estimator has it
    readings: NDArray[np.int64]
    reckoned: Trajectory


def datasets(paths: Sequence[str], robot: int | None) -> list[tuple[str, int | None]]:
    """Return the logs in recordings and folders of data sets: the path and, where there are several robots, the number.

    Raises UsageError for a path that is not there.
    """
    found: list[tuple[str, int | None]] = []
    for path in paths:
        if not Path(path).exists():
            raise UsageError(
                f"--set data={path}: not there; give folders of UTIAS MRCLAM data sets (mrclam.utias.utoronto.ca"
                " has them), or recordings that dynpf import mrclam made: --set \"data=['FOLDER', 'IN.mcap']\""
            )
        numbers = robots_in(Path(path)) if Path(path).is_dir() else []
        if robot is not None and numbers:
            numbers = [robot]
        found += [(path, number) for number in numbers] or [(path, None)]
    return found


@lru_cache(maxsize=2)
def opened(path: str, robot: int | None) -> LandmarkLog:
    """Return a log; raises ImportFailedError, RecordingError or UsageError where there is no usable log."""
    if Path(path).is_dir():
        log = import_mrclam(Path(path), robot)
        whole, landmarks = tuple(log.records), landmarks_of(log.attachments)
    else:
        played = PlayedLog(Path(path))
        whole = tuple(
            Record(record.topic, record.stamp_ns, decode(record.topic, record.payload)) for record in played.records
        )
        landmarks = tuple(msgspec.convert(played.facts.landmarks, list[Landmark]))
    poses = [(record.stamp_ns, record.message) for record in whole if isinstance(record.message, RobotState)]
    records = tuple(record for record in whole if record.topic in ("log/odometry", "log/landmarks"))
    if len(poses) < 2 or not any(isinstance(record.message, LandmarkReadings) for record in records):
        raise UsageError(f"{path}: has no landmark readings with a reference to score against")
    truth = Trajectory(
        np.array([stamp for stamp, _ in poses]) * 1e-9,
        np.array([(state.x, state.y, state.theta) for _, state in poses]).T,
    )
    name = Path(path).stem if robot is None else f"{Path(path).stem} robot {robot}"
    return LandmarkLog(name, records, truth, np.array([state.heading_valid for _, state in poses]), landmarks)


def stretches(log: LandmarkLog, count: int, length: float) -> list[Stretch]:
    """Return stretches of ``length`` seconds whose starts are spread evenly over the log.

    The starts are poses of the reference with a valid heading that follow no gap.
    """
    stamps = log.truth.stamps
    begin, end = max(log.start_ns * 1e-9, stamps[0]), min(log.records[-1].stamp_ns * 1e-9, stamps[-1])
    good = log.heading_valid & (np.diff(stamps, prepend=stamps[0]) <= GAP_S)
    good &= (stamps >= begin) & (stamps <= max(end - length, begin + 1.0))
    starts = np.flatnonzero(good)
    if starts.size < count:
        raise UsageError(f"{log.name}: its reference has no {count} poses from which to start {length:g} s; take fewer")
    found = []
    for index in starts[np.arange(count) * starts.size // count].tolist():
        first = float(stamps[index]) - log.start_ns * 1e-9
        x, y, theta = log.truth.poses[:, index].tolist()
        found.append(Stretch(first, first + length, (x, y, theta)))
    return found


def follow(
    log: LandmarkLog, stretch: Stretch, seed: int, overrides: Sequence[str], change: Change | None = None
) -> Run:
    """Run the scenario on a stretch of a log, its settings overridden as on the command line.

    ``change`` may leave out or move records.
    """
    marks = [msgspec.to_builtins(mark) for mark in log.landmarks]
    facts = LogFacts(digest="", landmarks=marks, starts={"": stretch.pose})
    scenario = load_scenario(SCENARIO, overrides=overrides, seed=seed, log=facts)
    first, last = (log.start_ns + round(second * 1e9) for second in stretch[:2])
    records: Sequence[Record] = [record for record in log.records if first <= record.stamp_ns <= last]
    if change is not None:
        records = change(records)
    played = LogContent(
        LogRecord(record.topic, record.stamp_ns, encode(record.topic, record.message)) for record in records
    )
    return _scored(drive(scenario, _TOPICS, played))


def _scored(run: RunMessages) -> Run:
    """Return the scored estimates, at most ten a second."""
    estimated, reckoned = run.topic("estimator/state"), reckoned_path(run)
    chosen = [estimated[index] for index in thin(seconds(estimated), SCORED_HZ)]
    estimates = of_type(chosen, Estimate)
    covariances = np.array([estimate.covariance for estimate in estimates]).reshape(-1, 3, 3)[:, :2, :2]
    read = run.topic("sensors/landmarks")
    counts = np.cumsum([0, *(len(message.readings) for message in of_type(read, LandmarkReadings))])
    seen = np.searchsorted([timed.number for timed in read], [timed.number for timed in chosen])
    at = thin(reckoned.stamps, SCORED_HZ)
    return Run(
        Trajectory(
            seconds(chosen),
            np.array([(estimate.x, estimate.y, estimate.theta) for estimate in estimates]).reshape(-1, 3).T,
        ),
        np.sqrt(np.linalg.eigvalsh(covariances)[:, -1]),
        counts[seen].astype(np.int64),
        Trajectory(reckoned.stamps[at], reckoned.poses[:, at]),
    )


# Changes of the records.


def withheld(count: int) -> Change:
    """Return a change that leaves out the first ``count`` readings and keeps odometry."""

    def change(records: Sequence[Record]) -> list[Record]:
        """Return the records without the first readings."""
        left, kept = count, []
        for record in records:
            if isinstance(record.message, LandmarkReadings) and left > 0:
                rest = record.message.readings[left:]
                left -= len(record.message.readings)
                kept += [record._replace(message=LandmarkReadings(readings=rest))] if rest else []
            else:
                kept.append(record)
        return kept

    return change


def every_second_landmark(records: Sequence[Record]) -> list[Record]:
    """Leave out readings of landmarks with odd numbers."""
    return [record for record in map(_even_only, records) if record is not None]


def _even_only(record: Record) -> Record | None:
    if not isinstance(record.message, LandmarkReadings):
        return record
    kept = tuple(reading for reading in record.message.readings if reading.landmark % 2 == 0)
    return record._replace(message=LandmarkReadings(readings=kept)) if kept else None


def nearest_past(records: Sequence[Record]) -> list[Record]:
    """Pair each odometry record with the newest readings before it, given the same stamp; leave out other readings.

    LANDMARK, section 5, remark 1.
    """
    return list(_paired(records))


def _paired(records: Sequence[Record]) -> Iterator[Record]:
    newest: Record | None = None
    for record in records:
        if isinstance(record.message, LandmarkReadings):
            newest = record
            continue
        yield record
        if newest is not None:
            yield newest._replace(stamp_ns=record.stamp_ns)
            newest = None
