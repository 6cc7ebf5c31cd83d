"""Straight pieces of wall in a scan, by split and merge (TURTLEBOT, "extract data laser scan").

The algorithm and its place among others: Nguyen, Gaechter, Martinelli, Tomatis and Siegwart, "A comparison of line
extraction algorithms using 2D range data for indoor mobile robotics", Autonomous Robots 23 (2007).
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.measurement.lines import Lines
from dynpf.measurement.scan import Scan
from dynpf.portable import atan2, hypot, sincos
from dynpf.types import FloatArray, NonNegative, Positive

__all__ = ["SplitAndMergeParams", "extract_lines", "fit_line"]


class SplitAndMergeParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When a chain of points is no longer one line, and when a line is worth telling of."""

    gap: Positive = 0.25  # m between neighbouring points at which a chain ends, plus ...
    gap_beams: NonNegative = 3.0  # ... so many times the distance between beams at that range
    split: Positive = 0.08  # m of a point from the line at which a chain is split there, and two are not merged
    min_points: Annotated[int, Meta(ge=2)] = 8
    min_length: Positive = 0.4  # m


def extract_lines(scan: Scan, params: SplitAndMergeParams) -> Lines:
    """Return the lines in a scan, in the order of its beams, with their middles; there may be none.

    Beams without return, too near or not a number end a chain no more than a gap does: their points are just not there.
    """
    angles, ranges = scan.beams()
    seen = np.isfinite(angles) & (ranges >= scan.range_min) & (ranges > 0.0) & (ranges < scan.range_max)
    at, far = angles[seen].astype(np.float64), ranges[seen].astype(np.float64)
    sine, cosine = sincos(at)
    points = far * np.stack([cosine, sine])
    pieces = [piece for chain in _chains(points, at, far, params) for piece in _split(points, *chain, params)]
    found = [_polar(points[:, first:last]) for first, last in _merged(points, pieces, params)]
    kept = [line for line in found if line[2] >= params.min_length]
    return Lines(*np.array(kept, dtype=np.float64).reshape(-1, 4).T)


def fit_line(points: FloatArray) -> tuple[float, float]:
    """Return (rho, alpha) of the line with the least squared distances from points (2, K), K >= 2; rho may be < 0."""
    x, y = points.mean(axis=1)
    dx, dy = points[0] - x, points[1] - y
    alpha = 0.5 * atan2(-2.0 * float(np.sum(dx * dy)), float(np.sum(dy * dy) - np.sum(dx * dx)))
    sine, cosine = sincos(alpha)
    return float(x * cosine + y * sine), alpha


def _chains(
    points: FloatArray, angles: FloatArray, ranges: FloatArray, params: SplitAndMergeParams
) -> Iterator[tuple[int, int]]:
    """Yield where chains of neighbouring points begin and end."""
    if ranges.size < 2:
        return
    steps = np.sort(np.abs(np.diff(angles)))
    step = 0.5 * (steps[(steps.size - 1) // 2] + steps[steps.size // 2])  # the median
    far = hypot(*np.diff(points)) > params.gap + params.gap_beams * step * np.minimum(ranges[1:], ranges[:-1])
    ends = [0, *(np.flatnonzero(far) + 1).tolist(), ranges.size]
    yield from ((first, last) for first, last in pairwise(ends) if last - first >= 2)


def _split(points: FloatArray, first: int, last: int, params: SplitAndMergeParams) -> Iterator[tuple[int, int]]:
    """Yield the straight pieces of a chain: split where a point is farthest from the chord of its ends."""
    if last - first < params.min_points:
        return
    start, end = points[:, first], points[:, last - 1]
    along = end - start
    length = hypot(*along.tolist())
    from_start = points[:, first:last] - start[:, None]
    beside = np.abs(along[0] * from_start[1] - along[1] * from_start[0])
    off = beside / length if length > 0.0 else hypot(from_start[0], from_start[1])
    worst = int(np.argmax(off))
    if off[worst] <= params.split:
        yield first, last
        return
    # The point at the corner belongs to both; one next to an end would leave the same chain over again.
    corner = first + min(max(worst, 1), last - first - 2)
    yield from _split(points, first, corner + 1, params)
    yield from _split(points, corner, last, params)


def _merged(
    points: FloatArray, pieces: list[tuple[int, int]], params: SplitAndMergeParams
) -> Iterator[tuple[int, int]]:
    """Yield pieces, those that share a corner put together where one line is near all of their points."""
    held: tuple[int, int] | None = None
    for piece in pieces:
        if held is not None and piece[0] < held[1] and _is_straight(points[:, held[0] : piece[1]], params.split):
            held = held[0], piece[1]
            continue
        if held is not None:
            yield held
        held = piece
    if held is not None:
        yield held


def _is_straight(points: FloatArray, most: float) -> bool:
    rho, alpha = fit_line(points)
    sine, cosine = sincos(alpha)
    return bool(np.max(np.abs(points[0] * cosine + points[1] * sine - rho)) <= most)


def _polar(points: FloatArray) -> tuple[float, float, float, float]:
    """Return rho >= 0, alpha, length and middle of the line through points (2, K)."""
    rho, alpha = fit_line(points)
    if rho < 0.0:
        rho, alpha = -rho, alpha + math.pi
    sine, cosine = sincos(alpha)
    along = points[1] * cosine - points[0] * sine
    first, last = float(along.min()), float(along.max())
    return rho, math.remainder(alpha, math.tau), last - first, 0.5 * (first + last)
