"""The world from above on a pair of axes: map, landmarks, bodies, paths, particles, the robot at a moment."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from dynpf.types import FloatArray
from dynpf_experiments.pictures.drawing import Layer, Shape, Track
from dynpf_experiments.pictures.whole import Whole
from dynpf_experiments.plots.style import BODIES, EDGES, ESTIMATES, ROLES

__all__ = ["draw_bodies", "draw_map", "draw_paths", "draw_robots", "frame", "labelled"]

MOST_CELLS = 1500
"""Cells of a map along its longer side that are drawn; a larger one is thinned."""


def draw_map(axes: Any, run: Whole, at: float | None = None) -> None:
    """Draw maps, walls, landmarks, goals, and the layers as they were ``at`` a moment, s; by default at the end."""
    for grid in run.drawing.grids:
        _draw_grid(axes, grid)
    shapes = [*run.drawing.shapes, *(shape for layer in run.drawing.layers for shape in _shown(layer, at))]
    for shape in shapes:
        _draw_shape(axes, shape)
    axes.set_aspect("equal")
    axes.set_xlabel(f"x ({run.drawing.unit.name})")
    axes.set_ylabel(f"y ({run.drawing.unit.name})")
    axes.grid(visible=False)


def draw_paths(axes: Any, run: Whole, until: float | None = None) -> None:
    """Draw the paths of all that moves, up to a moment, s."""
    for track, style in labelled(run):
        last = _count(track.seconds, until)
        if last:
            x, y = _broken_at_leaps(track.poses[:2, :last])
            axes.plot(x, y, **style)


def draw_robots(axes: Any, run: Whole, at: float) -> None:
    """Draw where everything was at a moment: particles, discs or points with their headings, 3-sigma ellipses."""
    for cloud in run.clouds:
        number = _count(cloud.seconds, at) - 1
        if number >= 0:
            axes.plot(*cloud.points[number], ".", color=ROLES["odometry"]["color"], ms=2.0, alpha=0.5, zorder=2)
    for track, style in labelled(run):
        number = _count(track.seconds, at) - 1
        if number >= 0 and track.role != "odometry":
            _draw_robot(axes, track, number, style.get("color", "#222222"))


def draw_bodies(axes: Any, run: Whole) -> None:
    """Draw the bodies beside the robot where they are at the end."""
    for track, style in labelled(run):
        if track.role == "body" and track.radius > 0.0 and track.seconds.size:
            _draw_robot(axes, track, track.seconds.size - 1, style["color"])


def frame(axes: Any, run: Whole) -> None:
    """Set the limits so that paths and shapes are seen, whatever moment is drawn."""
    tracks = [track.poses[:2] for track in run.tracks if track.role != "odometry" and track.seconds.size]
    shapes = [*run.drawing.shapes, *(shape for layer in run.drawing.layers for at in layer.shapes for shape in at)]
    points = [*tracks, *(shape.points for shape in shapes if shape.points.size), *map(_corners, run.drawing.grids)]
    if not points:
        return
    everything = np.concatenate(points, axis=1)
    low, high = np.nanmin(everything, axis=1), np.nanmax(everything, axis=1)
    margin = 0.05 * max(float(np.max(high - low)), 1e-6) + max((track.radius for track in run.tracks), default=0.0)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)


def labelled(run: Whole) -> Iterable[tuple[Track, dict[str, Any]]]:
    """Yield the tracks of a run with how each is drawn; several estimates and bodies have colours and names."""
    estimates = [track for track in run.tracks if track.role == "estimate"]
    bodies = [track for track in run.tracks if track.role == "body"]
    several = len({track.robot for track in run.tracks}) > 1
    for track in run.tracks:
        style = dict(ROLES[track.role])
        if track.role == "body":
            index = bodies.index(track)
            style |= {"color": BODIES[index % len(BODIES)], "label": track.name}
        elif track.role == "estimate" and len(estimates) > 1:
            style |= {"color": ESTIMATES[estimates.index(track) % len(ESTIMATES)], "label": track.name}
        elif several and track.robot:
            style["label"] = f"{style['label']} of {track.robot}"
        yield track, style


def _draw_grid(axes: Any, grid: Any) -> None:
    stride = -(-max(grid.cells.shape) // MOST_CELLS)
    occupied, free = grid.occupied[::stride, ::stride], grid.free[::stride, ::stride]
    shade = np.where(occupied, 0.15, np.where(free, 1.0, 0.85))
    from matplotlib.transforms import Affine2D  # noqa: PLC0415 - comes with the extra

    height, width = grid.cells.shape
    x, y, theta = grid.origin
    placed = Affine2D().rotate(theta).translate(x, y) + axes.transData
    extent = (0.0, width * grid.resolution, 0.0, height * grid.resolution)
    axes.imshow(
        shade,
        cmap="gray",
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=extent,
        transform=placed,
        zorder=0,
        interpolation="nearest",
    )


def _corners(grid: Any) -> FloatArray:
    height, width = (side * grid.resolution for side in grid.cells.shape)
    x, y, theta = grid.origin
    cosine, sine = np.cos(theta), np.sin(theta)
    corners = np.array([(0.0, width, width, 0.0), (0.0, 0.0, height, height)])
    along, across = corners
    return np.array([x + cosine * along - sine * across, y + sine * along + cosine * across])


def _draw_shape(axes: Any, shape: Shape) -> None:
    from matplotlib.patches import Circle, Polygon  # noqa: PLC0415 - comes with the extra

    colour = shape.colour or EDGES[shape.part]
    points = shape.points
    match shape.form:
        case "line":
            axes.plot(*points, color=colour, lw=1.2, zorder=1)
        case "loop":
            axes.plot(*np.concatenate([points, points[:, :1]], axis=1), color=colour, lw=1.4, zorder=1)
        case "pairs":
            gap = np.full((2, points.shape[1] // 2), np.nan)
            lines = np.stack([points[:, 0::2], points[:, 1::2], gap], axis=2).reshape(2, -1)
            axes.plot(*lines, color=colour, lw=1.4, zorder=1)
        case "area":
            axes.add_patch(Polygon(points.T, facecolor=colour, alpha=0.3, lw=0, zorder=0.5))
        case "disc" if shape.radius > 0.0:
            for x, y in points.T:
                dashed = shape.part == "goal"
                axes.add_patch(
                    Circle((x, y), shape.radius, fill=dashed, color=colour, alpha=0.35 if dashed else 1.0, zorder=1)
                )
        case "disc":
            axes.plot(*points, "^", color=colour, ms=5, ls="none", zorder=1)
    if shape.text and points.size:
        offset = (0, 0) if shape.form == "text" else (4, 4)
        axes.annotate(shape.text, points[:, 0], xytext=offset, textcoords="offset points", fontsize=7, color=colour)


def _draw_robot(axes: Any, track: Track, number: int, colour: str) -> None:
    from matplotlib.patches import Circle, Ellipse  # noqa: PLC0415 - comes with the extra

    x, y, theta = track.poses[:, number]
    if not np.isfinite(x + y):
        return
    radius = track.radius
    if radius > 0.0:
        axes.add_patch(Circle((x, y), radius, fill=track.role == "body", color=colour, alpha=0.6, lw=1.4, zorder=3))
    else:
        axes.plot([x], [y], "o", color=colour, ms=5, zorder=3)
    if np.isfinite(theta) and track.role != "body":
        length = max(1.6 * radius, 0.03 * float(np.ptp(axes.get_xlim())))
        axes.plot([x, x + length * np.cos(theta)], [y, y + length * np.sin(theta)], color=colour, lw=1.6, zorder=3)
    if track.covariances is not None:
        values, vectors = np.linalg.eigh(track.covariances[:2, :2, number])
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        width, height = 6.0 * np.sqrt(np.maximum(values[::-1], 0.0))
        axes.add_patch(Ellipse((x, y), width, height, angle=angle, fill=False, color=colour, lw=1.0, zorder=3))


def _shown(layer: Layer, at: float | None) -> Sequence[Shape]:
    number = _count(layer.seconds, at) - 1
    return layer.shapes[number] if 0 <= number < len(layer.shapes) else ()


def _count(seconds: FloatArray, at: float | None) -> int:
    """Return how many of the times are no later than a moment."""
    return seconds.size if at is None else int(np.searchsorted(seconds, at + 1e-9, side="right"))


def _broken_at_leaps(points: FloatArray) -> FloatArray:
    """Return the points with a gap where a path leaps: 30 times as far as usual, and half a metre."""
    if points.shape[1] < 3:
        return points
    steps = np.hypot(*np.diff(points, axis=1))
    usual = float(np.nanmedian(steps))
    leaps = np.flatnonzero((steps > 0.5) & (steps > 30.0 * max(usual, 1e-6)))
    return np.insert(points, leaps + 1, np.nan, axis=1)
