"""Logs with laser scans for studies: logs known by name, and imported recordings."""

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from dynpf_experiments.data import data_path
from dynpf_formats.importers import log as imported
from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.log import ImportedLog
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.importers.maps import map_attachments
from dynpf_formats.recording.attachments import attached, files_of
from dynpf_formats.recording.header import Attachment
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import LaserScan, Message, OdometryPose, RobotState, Scanner
from dynpf_runtime.source import LogRecord
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.schema import LogFacts

from dynpf.se2 import wrap_angle
from dynpf_systems.rooms.studies.logs import LaserSource, sources

__all__ = ["LaserLog", "Record", "encoded", "imported_log", "log_named", "read_laser_log", "split"]

_INSTEAD = "--set \"logs=['IN.mcap']\" takes recordings that dynpf import has made"


class Record(NamedTuple):
    """A message of a log, and its number among the messages."""

    number: int
    topic: str
    stamp_ns: int
    message: Message
    truth: tuple[float, float, float] | None  # of a scan; None where the reference lacks it
    scanner: Scanner | None = None  # of a scan: the last announcement of its scanner


class LaserLog(NamedTuple):
    """Odometry and scans of an imported log, and what it brings to a scenario."""

    name: str
    records: tuple[Record, ...]
    facts: LogFacts

    @property
    def scans(self) -> list[int]:
        """Return the indices of the records that are scans with a known true pose."""
        return [index for index, record in enumerate(self.records) if record.truth is not None]

    @property
    def scanner(self) -> Scanner | None:
        """Return the scanner with the greatest range; None where no scanner of a scan has announced itself."""
        known = [record.scanner for record in self.records if record.scanner is not None]
        return max(known, key=lambda scanner: scanner.range_max, default=None)


@cache
def log_named(name: str) -> LaserLog:
    """Return a log by its name or by the path of an imported recording; raises UsageError where there is none."""
    known = sources().laser
    if name not in known:
        if not Path(name).is_file():
            raise UsageError(f"logs: {name} is neither a file nor one of {', '.join(known)}")
        return read_laser_log(Path(name))
    source = known[name]
    if source.split_of:
        return split(log_named(source.split_of), known[source.split_of].map_from_poses_m)
    return imported_log(name, _stream(name, source))


def _stream(name: str, source: LaserSource) -> ImportedLog:
    path = data_path(f"logs: {name}", source.file, _INSTEAD)
    if source.format == "carmen":
        drawn = drawn_map(lambda: import_carmen(path).records, source.map_from_poses_m, "map")
        return import_carmen(path, attachments=drawn)
    # Only these logs need the package rosbags.
    from dynpf_formats.importers.rosbag import BagChoice, import_rosbag  # noqa: PLC0415

    choice = BagChoice(truth_offset=source.truth_offset, truth_shift=source.truth_shift_s)
    return import_rosbag(path, choice, attachments=_map_of(name, source))


def _map_of(name: str, source: LaserSource) -> tuple[Attachment, ...]:
    placed = source.placed_map
    if placed is None:
        return map_attachments(data_path(f"logs: {name}", source.map, _INSTEAD))
    image = data_path(f"logs: {name}", placed.image, _INSTEAD)
    return attached(image.with_suffix(".yaml").name, placed.yaml().encode()), attached(image.name, image.read_bytes())


def read_laser_log(path: Path) -> LaserLog:
    """Return an imported log; raises what PlayedLog raises."""
    log = PlayedLog(path)
    messages = [(record.topic, record.stamp_ns, decode(record.topic, record.payload)) for record in log.records]
    return _laser_log(path.stem, messages, log.facts)


def imported_log(name: str, stream: ImportedLog) -> LaserLog:
    """Return the log that an importer has read."""
    messages = [(record.topic, record.stamp_ns, record.message) for record in stream.records]
    files = files_of(stream.attachments)
    facts = LogFacts("", [], {}, files)
    return _laser_log(name, messages, facts)


def _laser_log(name: str, messages: Sequence[tuple[str, int, Message]], facts: LogFacts) -> LaserLog:
    """Return the log; the true pose of a scan is the reference interpolated linearly at its stamp."""
    known = {stamp: (m.x, m.y, m.theta) for _, stamp, m in messages if isinstance(m, RobotState)}
    stamps = np.array(sorted(known), dtype=np.int64)
    poses = np.array([known[stamp] for stamp in stamps.tolist()]).reshape(-1, 3)
    since, headings = (stamps - stamps[:1]).astype(np.float64), np.unwrap(poses[:, 2])

    def truth(stamp: int) -> tuple[float, float, float] | None:
        """Return the interpolated true pose at a stamp, None outside of the reference."""
        if stamps.size == 0 or not stamps[0] <= stamp <= stamps[-1]:
            return None
        x, y, theta = (float(np.interp(stamp - stamps[0], since, values)) for values in (*poses[:, :2].T, headings))
        return x, y, float(wrap_angle(theta))

    records = []
    scanner: Scanner | None = None
    for number, (topic, stamp, message) in enumerate(messages):
        match message:
            case Scanner():
                scanner = message
            case LaserScan():
                records.append(Record(number, topic, stamp, message, truth(stamp), scanner))
            case OdometryPose():
                records.append(Record(number, topic, stamp, message, None))
    return LaserLog(name, tuple(records), facts)


def encoded(records: Iterable[Record]) -> Iterator[LogRecord]:
    """Yield records of a log as sensors play them; each scanner's announcement comes before the first of its scans.

    Records are encoded as they are played, since most runs end long before the log does.
    """
    announced: Scanner | None = None
    for record in records:
        if record.scanner is not None and record.scanner != announced:
            announced = record.scanner
            yield LogRecord("log/scanner", record.stamp_ns, encode("log/scanner", announced))
        yield LogRecord(record.topic, record.stamp_ns, encode(record.topic, record.message))


def split(log: LaserLog, resolution: float = 0.05) -> LaserLog:
    """Return the log without every second of its scans; its map is drawn from the scans left out."""
    scans = log.scans
    drawn, rest = scans[::2], set(scans[1::2])

    def placed() -> Iterator[imported.Record]:
        """Yield the true pose and the scan of each record from which the map is drawn."""
        for index in drawn:
            record = log.records[index]
            assert record.truth is not None
            x, y, theta = record.truth
            yield imported.Record("log/truth", record.stamp_ns, RobotState(x=x, y=y, theta=theta, v=0.0, w=0.0))
            yield imported.Record(record.topic, record.stamp_ns, record.message)

    records = tuple(
        record for index, record in enumerate(log.records) if isinstance(record.message, OdometryPose) or index in rest
    )
    files = files_of(drawn_map(placed, resolution, "map"))
    return LaserLog(f"{log.name}-split", records, log.facts._replace(files=files))
