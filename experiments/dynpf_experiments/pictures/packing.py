"""Drawings as the page holds them: columns of rounded numbers, and no more of them than the budget has."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dynpf_protocol.printable import printable

from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.types import FloatArray
from dynpf_experiments.pictures.cameras import Camera, as_uri
from dynpf_experiments.pictures.columns import column, extremes, points, runs
from dynpf_experiments.pictures.drawing import Layer, Line, Plot, Shape, Track
from dynpf_experiments.pictures.tracks import Clouds, Readings

__all__ = ["bounds_of", "camera", "cloud", "grid", "layer", "plot", "reading", "shape", "thinned", "track"]

SECOND, POSITION, ANGLE = 1e-3, 1e-4, 1e-4
"""The steps to which times, positions and angles are rounded: s, the drawing's unit, rad."""

MOST_CELLS_A_SIDE = 600
_SIGNIFICANT = 1e-5  # of the largest value of a line: the step to which its values are rounded


def thinned(track: Track, moments: FloatArray) -> Track:
    """Return of a track the poses that hold at the moments (M,), and the first."""
    held = np.searchsorted(track.seconds, moments + 0.5 * SECOND, side="right") - 1
    chosen = np.unique(np.maximum(held, 0))
    covariances = None if track.covariances is None else track.covariances[..., chosen]
    return track._replace(seconds=track.seconds[chosen], poses=track.poses[:, chosen], covariances=covariances)


def track(each: Track) -> dict[str, Any]:
    """Return a track; of the covariance that of the position."""
    found = {
        "name": printable(each.name, 80),
        "role": each.role,
        "robot": printable(each.robot, 80),
        "radius": _bare(each.radius),
        "t": column(each.seconds, SECOND),
        "x": column(each.poses[0], POSITION),
        "y": column(each.poses[1], POSITION),
        "h": column(each.poses[2], ANGLE),
    }
    if each.covariances is not None and each.covariances.size:
        entries = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1)}
        found["cov"] = {name: column(each.covariances[at], 1e-8) for name, at in entries.items()}
    return found


def cloud(each: Clouds) -> dict[str, Any]:
    """Return the particles of a node."""
    return {"node": printable(each.node, 80), "t": column(each.seconds, SECOND), "p": points(each.points)}


def reading(each: Readings) -> dict[str, Any]:
    """Return the readings of a sensor."""
    return {
        "topic": printable(each.topic, 80),
        "robot": printable(each.robot, 80),
        "form": each.form,
        "t": column(each.seconds, SECOND),
        "p": points(each.points),
    }


def shape(each: Shape) -> dict[str, Any]:
    """Return a shape."""
    known = {"f": each.form, "w": each.part, "x": column(each.points[0], 1e-3), "y": column(each.points[1], 1e-3)}
    extra = {"r": _bare(each.radius), "s": each.text, "c": each.colour}
    return known | {key: value for key, value in extra.items() if value}


def layer(each: Layer) -> dict[str, Any]:
    """Return shapes that change."""
    return {
        "t": column(each.seconds, SECOND),
        "shapes": [[shape(one) for one in shapes] for shapes in each.shapes],
    }


def grid(each: OccupancyGrid) -> dict[str, Any]:
    """Return a map of cells, those of a block as one where there are too many: occupied if one is, free if one is."""
    height, width = each.cells.shape
    side = -(-max(height, width) // MOST_CELLS_A_SIDE)
    rows, columns = -(-height // side), -(-width // side)
    padded = np.full((rows * side, columns * side), UNKNOWN, dtype=np.uint8)
    padded[:height, :width] = each.cells
    blocks = padded.reshape(rows, side, columns, side)
    occupied, free = (np.any(blocks == value, axis=(1, 3)) for value in (OCCUPIED, FREE))
    cells = np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)
    return {
        "w": columns,
        "h": rows,
        "resolution": each.resolution * side,
        "origin": [_bare(value) for value in each.origin],
        "runs": runs(cells),
    }


def plot(each: Plot, most: int) -> dict[str, Any]:
    """Return a plot, its lines thinned together where they have the same times, so that no peak is lost."""
    lines = [line for line in each.lines if line.values.size]
    return {
        "key": each.key,
        "title": each.title,
        "unit": each.unit,
        "about": each.about,
        "signed": each.signed,
        "lines": [_line(line, most) for line in lines],
    }


def camera(each: Camera) -> dict[str, Any]:
    """Return a camera's thumbnails."""
    return {
        "topic": printable(each.topic, 80),
        "w": each.width,
        "h": each.height,
        "t": column([frame.seconds for frame in each.frames], SECOND),
        "src": [as_uri(frame.jpeg) for frame in each.frames],
        "circles": [
            [[round(float(value), 1) for value in circle] for circle in frame.circles] for frame in each.frames
        ],
    }


def bounds_of(
    shapes: Sequence[Shape], grids: Sequence[OccupancyGrid], tracks: Sequence[Track]
) -> tuple[float, float, float, float]:
    """Return left, bottom, right and top of the world: what is fixed, and true and estimated paths.

    Odometry alone may leave it by a fifth of its size, and is cut beyond.
    """
    parts = [each.points for each in shapes if each.part != "drawn" or not grids]
    parts += [_extent(each) for each in grids]
    parts += [each.poses[:2] for each in tracks if each.role != "odometry"]
    inner = _box(parts)
    odometry = _box([each.poses[:2] for each in tracks if each.role == "odometry"])
    if inner is None:
        inner = odometry or (-1.0, -1.0, 1.0, 1.0)
    left, bottom, right, top = inner
    margin = 0.05 * max(right - left, top - bottom, 1e-3)
    reach = 0.2 * max(right - left, top - bottom)
    if odometry is not None:
        left, bottom = max(min(left, odometry[0]), left - reach), max(min(bottom, odometry[1]), bottom - reach)
        right, top = min(max(right, odometry[2]), right + reach), min(max(top, odometry[3]), top + reach)
    return _bare(left - margin), _bare(bottom - margin), _bare(right + margin), _bare(top + margin)


def _box(parts: Sequence[FloatArray]) -> tuple[float, float, float, float] | None:
    known = [part[:, np.isfinite(part).all(axis=0) & (np.abs(part) <= 1e7).all(axis=0)] for part in parts]
    known = [part for part in known if part.size]
    if not known:
        return None
    left, bottom = (min(float(part[axis].min()) for part in known) for axis in (0, 1))
    right, top = (max(float(part[axis].max()) for part in known) for axis in (0, 1))
    return left, bottom, right, top


def _extent(each: OccupancyGrid) -> FloatArray:
    """Return the corners of what is known in a map, (2, 4)."""
    rows, columns = (np.flatnonzero(np.any(each.cells != UNKNOWN, axis=axis)) for axis in (1, 0))
    if not rows.size:
        return np.empty((2, 0))
    across, along = (rows[0], rows[-1] + 1), (columns[0], columns[-1] + 1)
    x, y = each.to_map([along[0], along[1], along[1], along[0]], [across[0], across[0], across[1], across[1]])
    return np.stack([x, y])


def _line(line: Line, most: int) -> dict[str, Any]:
    chosen = extremes(line.values, most)
    values = line.values[chosen]
    largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
    return {
        "label": printable(line.label, 80),
        "kind": line.kind,
        "hidden": line.hidden,
        "t": column(line.seconds[chosen], SECOND),
        "v": column(values, _rounded(largest * _SIGNIFICANT)),
    }


def _rounded(step: float) -> float:
    """Return the power of ten not above a step, at least 1e-9."""
    exponent = -9
    while exponent < 4 and 10.0 ** (exponent + 1) <= step:
        exponent += 1
    return float(f"1e{exponent}")


def _bare(value: float) -> float:
    return round(float(value), 4)
