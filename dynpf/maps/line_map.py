"""A map of segments made of the lines that scans showed from known poses."""

import math
from collections.abc import Iterable

import msgspec
import numpy as np

from dynpf.maps.segments import SegmentMap
from dynpf.measurement.lines import Lines
from dynpf.params import validated
from dynpf.portable import norm, sin, sincos
from dynpf.types import Count, FloatArray, Positive

__all__ = ["LineMapParams", "line_map", "placed"]


class LineMapParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When two lines are pieces of one wall, and how often a wall has to be seen."""

    off: Positive = 0.1  # m of either end from the other line
    gap: Positive = 0.3  # m between the pieces
    turn: Positive = math.radians(6.0)  # rad between directions
    sightings: Count = 3  # scans that showed a piece of it


def placed(lines: Lines, pose: FloatArray) -> FloatArray:
    """Return lines of known middle, seen from a pose (3,), as segments (K, 4) in the map frame."""
    if lines.middles is None:
        raise ValueError("placed: lines without middles have a direction, but no place")
    rho, alpha, lengths, middles = (np.asarray(row, dtype=np.float64) for row in (*lines[:3], lines.middles))
    across, ahead = sincos(alpha)
    sine, cosine = sincos(float(pose[2]))
    ends = []
    for along in (middles - 0.5 * lengths, middles + 0.5 * lengths):
        x, y = rho * ahead - along * across, rho * across + along * ahead
        ends += [pose[0] + cosine * x - sine * y, pose[1] + sine * x + cosine * y]
    return np.stack(ends, axis=1)


def line_map(segments: Iterable[FloatArray], params: LineMapParams) -> SegmentMap:
    """Return the walls of which segments (K, 4), those of each scan by themselves, are pieces.

    Longer ones come first and keep their direction; what lies along one and touches it makes it longer. Raises
    ValueError where no wall was seen often enough.
    """
    params = validated(params)
    pieces = np.concatenate([np.empty((0, 4)), *segments])
    pieces = pieces[np.argsort(-norm(pieces[:, 2:] - pieces[:, :2], axis=1), kind="stable")]
    walls = np.empty((len(pieces), 6))  # a point on the wall, its direction, and from where to where it goes from there
    sightings = np.zeros(len(pieces), dtype=np.int64)
    count = 0
    for piece in pieces:
        first, last = piece[:2], piece[2:]
        length = norm(last - first)
        x, y, dx, dy, start, end = walls[:count].T
        along, across = [], []
        for point in (first, last):
            along.append((point[0] - x) * dx + (point[1] - y) * dy)
            across.append(np.abs((point[1] - y) * dx - (point[0] - x) * dy))
        low, high = np.minimum(*along), np.maximum(*along)
        turned = np.abs((last[1] - first[1]) * dx - (last[0] - first[0]) * dy)
        parallel = turned <= sin(params.turn) * length
        near = parallel & (np.maximum(*across) <= params.off) & (low <= end + params.gap) & (high >= start - params.gap)
        if near.any():
            wall = int(np.argmax(np.where(near, sightings[:count], -1)))
            walls[wall, 4:] = min(start[wall], low[wall]), max(end[wall], high[wall])
        else:
            wall, count = count, count + 1
            walls[wall] = (*first, *((last - first) / length), 0.0, length)
        sightings[wall] += 1
    x, y, dx, dy, start, end = walls[:count][sightings[:count] >= params.sightings].T
    return SegmentMap(np.stack([x + start * dx, y + start * dy, x + end * dx, y + end * dy], axis=1))
