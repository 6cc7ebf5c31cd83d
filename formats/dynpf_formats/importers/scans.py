"""Foreign range scans as LaserScan messages: every range is a number of metres, a beam without a reading the maximum.

A separate record gives the least and greatest range of the scanner, before its first scan and wherever they change.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import LaserScan, Message, Scanner, planar_pose, timestamp
from numpy.typing import ArrayLike

from dynpf_formats.importers.log import Losses, Record

__all__ = ["MOST_BEAMS", "SCANNER", "normalized_scan", "scanner_record", "without_repeated_scanners"]

SCANNER = "log/scanner"

MOST_BEAMS = 100_000  # of one LaserScan message


def normalized_scan(
    stamp_ns: int,
    mount: tuple[float, float, float],
    span: tuple[float, float],
    ranges: ArrayLike,
    limits: tuple[float, float],
    *,
    losses: Losses,
) -> LaserScan | None:
    """Return a scan of B beams, or None if it has none or more than a message holds, which ``losses`` counts.

    ``mount`` is the sensor's pose on the robot (m, m, rad), ``span`` the angles of the first and the last beam (rad),
    ``ranges`` (B,) in metres, ``limits`` the least and the greatest range of the sensor. Ranges at or beyond the
    greatest are no return, as is infinity; NaN and ranges not above the least, or above 0, are lost beams.
    """
    values = np.asarray(ranges, dtype=np.float64)
    where = f"{stamp_ns * 1e-9:.3f} s"
    if not 0 < values.size <= MOST_BEAMS:
        losses.add("scans without beams or with too many", f"{where}: {values.size} beams")
        return None
    least, greatest = limits
    nan, short = np.isnan(values), values <= max(least, 0.0)
    if nan.any():
        losses.add("beams that are not a number", f"{where}: beam {int(nan.argmax())}", int(nan.sum()))
    if short.any():
        first = int(short.argmax())
        losses.add("beams not above the least range", f"{where}: {values[first]} m, beam {first}", int(short.sum()))
    values = np.where(nan | short | (values > greatest), greatest, values)
    return LaserScan(
        timestamp=timestamp(stamp_ns),
        frame_id=frames.ROBOT,
        pose=planar_pose(*mount),
        start_angle=span[0],
        end_angle=span[1],
        ranges=tuple(values.tolist()),
    )


def scanner_record(stamp_ns: int, limits: tuple[float, float]) -> Record:
    """Return the record of a scanner whose ranges lie between ``limits``, metres."""
    least, greatest = limits
    return Record(SCANNER, stamp_ns, Scanner(range_min=max(least, 0.0), range_max=greatest))


def without_repeated_scanners(records: Iterable[Record]) -> Iterator[Record]:
    """Yield the records, without scanner records that repeat the last one."""
    last: Message | None = None
    for record in records:
        if record.topic == SCANNER:
            if record.message == last:
                continue
            last = record.message
        yield record
