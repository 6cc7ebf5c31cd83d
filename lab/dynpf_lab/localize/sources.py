"""The log of ``dynpf localize``: whatever its format, as a recording of ours."""

import struct
from pathlib import Path
from typing import NamedTuple

from dynpf_experiments.extras import needing
from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.importers.maps import map_attachments
from dynpf_formats.importers.mrclam import import_mrclam
from dynpf_formats.recording.attachments import is_file
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.regular_files import open_regular
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.topics import LOG_NODE

__all__ = ["Source", "imported", "source_of"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
CELL_M = 0.05
"""Side of a cell of a map that is drawn from the log itself."""


class Source(NamedTuple):
    """Where a log comes from: ``kind`` is rosbag, carmen, mrclam or recording."""

    path: Path
    kind: str


def source_of(path: Path) -> Source:
    """Return what a log is, by its name and its first bytes; raises UsageError for one that cannot be read."""
    try:
        if path.is_dir():
            tables = any("Odometry.dat" in part.name for part in path.iterdir())
            return Source(path, "mrclam" if tables else "rosbag")
        if path.suffix in {".bag", ".db3"}:
            return Source(path, "rosbag")
        if path.suffix == ".mcap":
            return Source(path, "recording" if _profile(path) == "dynpf" else "rosbag")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
    return Source(path, "carmen")


def _profile(path: Path) -> str:
    """Return the profile in the header of an MCAP file; an empty text for what has none."""
    with open_regular(path) as stream:
        head = stream.read(len(MCAP_MAGIC) + 13)
        if len(head) < len(MCAP_MAGIC) + 13 or not head.startswith(MCAP_MAGIC):
            return ""
        _, _, length = struct.unpack_from("<BQI", head, len(MCAP_MAGIC))
        return stream.read(min(length, 64)).decode(errors="replace")


def imported(source: Source, map_file: Path | None, scan: str | None) -> ImportedLog | None:
    """Return the log of a source; None for a recording of ours that is taken as it is.

    ``scan`` is AMCL's topic of the scans, which is taken where a bag has it. Raises UsageError and what the importers
    raise.
    """
    attachments = () if map_file is None else map_attachments(map_file)
    match source.kind:
        case "recording":
            return _with_map(source.path, attachments) if attachments else None
        case "carmen":
            return _carmen(source.path, attachments)
        case "mrclam":
            if attachments:
                raise UsageError(f"--map {map_file}: {source.path} holds readings of landmarks, which need no map")
            return import_mrclam(source.path)
    return _rosbag(source.path, attachments, scan)


def _with_map(path: Path, attachments: tuple[Attachment, ...]) -> ImportedLog:
    recording = read_recording(path)
    records = (
        Record(record.topic, record.stamp_ns, decode(record.topic, record.payload))
        for record in recording.messages(node=LOG_NODE)
    )
    others = (attachment for attachment in recording.attachments if not is_file(attachment))
    return ImportedLog(path.name, "recording", {}, records, Losses(), (*others, *attachments))


def _carmen(path: Path, attachments: tuple[Attachment, ...]) -> ImportedLog:
    drawn = () if attachments else drawn_map(lambda: import_carmen(path).records, CELL_M, "map")
    log = import_carmen(path, attachments=attachments or drawn)
    return log._replace(settings={**log.settings, "map_from_poses": CELL_M}) if drawn else log


def _rosbag(path: Path, attachments: tuple[Attachment, ...], scan: str | None) -> ImportedLog:
    with needing("rosbags", extra="ros", what="reading ROS bags"):
        from dynpf_formats.importers.rosbag import BagChoice, import_rosbag  # noqa: PLC0415
    choice = BagChoice() if scan is None else BagChoice(scan=_named(path, scan))
    return import_rosbag(path, choice, attachments=attachments)


def _named(path: Path, scan: str) -> str | None:
    """Return the one topic of scans in a bag whose name ends so; None if there is none, or several."""
    from dynpf_formats.importers.bag_plan import SCANS, TYPES  # noqa: PLC0415  # needs rosbags
    from dynpf_formats.importers.bags import open_bag  # noqa: PLC0415

    with open_bag(path, TYPES) as bag:
        scans = bag.of_type(SCANS)
    wanted = scan.strip("/")
    named = [topic for topic in scans if topic.strip("/") == wanted or topic.endswith(f"/{wanted}")]
    return named[0] if len(named) == 1 else None
