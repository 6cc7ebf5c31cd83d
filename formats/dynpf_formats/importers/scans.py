"""Range scans of others as ours: every range a number of metres, a beam that tells nothing reads the maximum.

What a scanner measures between stands in a record of its own, before its first scan and where it changes.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import LaserScan, Message, Scanner, planar_pose, timestamp
from numpy.typing import ArrayLike

from dynpf_formats.importers.log import Record
from dynpf_formats.importers.stream import Losses

__all__ = ["MOST_BEAMS", "SCANNER", "changes_alone", "normalized_scan", "scanner_record"]

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
    """Return a scan of B beams, or None where it has none, or more than a message holds; ``losses`` tells it.

    ``mount`` is the sensor's pose on the robot (m, m, rad), ``span`` the angles of the first and the last beam (rad),
    ``ranges`` (B,) in metres, ``limits`` the least and the greatest range that the sensor gives. What is at the
    greatest range or beyond it is no return, as is infinity; NaN and what is below the least range are lost beams.
    """
    values = np.asarray(ranges, dtype=np.float64)
    place = f"{stamp_ns * 1e-9:.3f} s"
    if not 0 < values.size <= MOST_BEAMS:
        losses.add("scans without beams or with too many", f"{place}: {values.size} beams")
        return None
    least, greatest = limits
    nan, short = np.isnan(values), values < least
    if nan.any():
        losses.add("beams that are not a number", f"{place}: beam {int(nan.argmax())}", int(nan.sum()))
    if short.any():
        first = int(short.argmax())
        losses.add("beams below the least range", f"{place}: {values[first]} m, beam {first}", int(short.sum()))
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
    """Return what a scanner says of itself that gives ranges between ``limits``, metres."""
    least, greatest = limits
    return Record(SCANNER, stamp_ns, Scanner(range_min=max(least, 0.0), range_max=greatest))


def changes_alone(records: Iterable[Record]) -> Iterator[Record]:
    """Yield records, those of the scanner only where they say something new."""
    said: Message | None = None
    for record in records:
        if record.topic == SCANNER:
            if record.message == said:
                continue
            said = record.message
        yield record
