"""The whole chain from a grey image to discs: light, threshold, components, edges, circle fit, rejection."""

from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf.portable import norm
from dynpf.vision.background import estimate_background, flatten
from dynpf.vision.circle import fit_circles, fit_circles_algebraic
from dynpf.vision.components import arc_circles, foreground, trace_borders
from dynpf.vision.edges import inner_contrast, overlapping, rim_edges

__all__ = ["DetectionParams", "Disc", "detect_discs"]

_MIN_SIDE_PX = 16
_MIN_POINTS = 6
_LEAST_ARC_PX = 14.0  # on less than that, a circle lies by chance
_PIXEL_ROUGHNESS_PX = 0.35  # rms distance of edge pixels to the true rim


class DetectionParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What counts as a disc, in pixels of the image that is searched (a quarter of the frame's) and grey levels."""

    min_radius_px: Annotated[float, msgspec.Meta(ge=3)] = 4.0
    max_radius_px: Annotated[float, msgspec.Meta(gt=0)] = 40.0
    min_contrast: Annotated[float, msgspec.Meta(gt=0, le=255)] = 24.0  # to the background, grey levels
    max_residual: Annotated[float, msgspec.Meta(gt=0)] = 0.05  # rms distance of edge points to the circle / radius
    min_arc_fraction: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.2  # of the circumference, seen as an edge
    min_support: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.7  # of what another disc or the border does not hide
    rays: Annotated[int, msgspec.Meta(ge=16, le=512)] = 64  # edge points looked for around each disc
    background_degree: Annotated[int, msgspec.Meta(ge=0, le=6)] = 4  # of the polynomial through the light


class Disc(msgspec.Struct, frozen=True):
    """A disc in an image: a pixel's centre has whole coordinates, x to the right, y down."""

    x_px: float
    y_px: float
    radius_px: float
    grey: float  # median inside minus background, grey levels at the average light: negative is darker
    residual_px: float  # rms distance of the edge points to the circle
    arc_fraction: float  # of the circumference that edge points support


def detect_discs(grey: NDArray[np.uint8], params: DetectionParams) -> tuple[Disc, ...]:
    """Find the discs in a grey image (H, W), sorted by y, then x (PARTS section 5.2, stages 3 to 6).

    Discs may be darker or lighter than the background, touch each other, or be cut by the image's border, as long
    as `min_arc_fraction` of the rim is seen. Raises ValueError when `grey` is not a two-dimensional uint8 array.
    """
    if grey.ndim != 2 or grey.dtype != np.uint8:
        raise ValueError(f"need a grey image (H, W) of uint8, got shape {grey.shape} of {grey.dtype}")
    if min(grey.shape) < _MIN_SIDE_PX:
        return ()
    contrast = flatten(grey, estimate_background(grey, params.background_degree))
    mask = foreground(contrast, params.min_contrast)
    circles = _coarse_circles(mask, params)
    if len(circles) == 0:
        return ()
    rims = _best_discs(contrast, circles, params)
    if len(rims.circles) < len(circles):  # what was no disc has hidden parts of rims, or lent them
        rims = _best_discs(contrast, rims.circles, params)
    circles = rims.circles
    level = inner_contrast(contrast, circles)
    discs = [
        Disc(*(float(value) for value in (*circles[i], level[i], rims.residual[i], rims.arc[i])))
        for i in np.flatnonzero(np.abs(level) >= params.min_contrast)
    ]
    return tuple(sorted(discs, key=lambda disc: (disc.y_px, disc.x_px)))


def _coarse_circles(mask: NDArray[np.uint8], params: DetectionParams) -> NDArray[np.float64]:
    """Circles (D, 3) about a pixel from the rim: one through a component if that fits it, else those of its arcs."""
    borders = trace_borders(mask, np.pi * params.min_radius_px * params.min_radius_px / 2)
    if len(borders.px) == 0:
        return np.zeros((0, 3))
    outside = borders.outer & borders.edge
    member = (borders.component == np.arange(borders.component.max() + 1)[:, None]) & outside
    weights = member.astype(np.float64)
    single = fit_circles_algebraic(borders.px[None], weights)
    count = np.maximum(member.sum(axis=1), 1)
    residual = np.sqrt((weights * np.square(_distance(borders.px, single))).sum(axis=1) / count)
    fits = (residual <= _PIXEL_ROUGHNESS_PX + 0.5 * params.max_residual * single[:, 2]) & _of_size(single, params)
    several = arc_circles(borders, ~fits, params.min_radius_px, params.max_radius_px)
    circles = np.concatenate([single[fits], several])
    circles[:, 2] += 0.5  # edge pixels are the outermost inside
    return circles[_of_size(circles, params)]


def _distance(points: NDArray[np.float64], circles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distance (D, K) of points (K, 2) or (D, K, 2) to the rims of circles (D, 3)."""
    return np.asarray(norm(points - circles[:, None, :2], axis=2) - circles[:, 2, None])


class _Rims(NamedTuple):
    """Circles (D, 3) fitted to sub-pixel edges, rms residuals (D,), and how much of each rim was seen."""

    circles: NDArray[np.float64]
    residual: NDArray[np.float64]
    arc: NDArray[np.float64]  # (D,) share of the circumference that edge points support
    support: NDArray[np.float64]  # (D,) the same of what can be seen of it
    merit: NDArray[np.float64]  # (D,) mean fall of the contrast across the rim


def _refine(contrast: NDArray[np.float32], circles: NDArray[np.float64], params: DetectionParams) -> _Rims:
    """Fit the circles (D, 3) to their edges, twice: the second time the rays cross the edge squarely."""
    rim = rim_edges(contrast, circles, params.rays)
    fitted, _ = fit_circles(rim.points_px, rim.found.astype(np.float64), circles)
    usable = (rim.found.sum(axis=1) >= _MIN_POINTS) & _of_size(fitted, params)
    circles = np.where(usable[:, None], fitted, circles)
    rim = rim_edges(contrast, circles, params.rays)
    fitted, _ = fit_circles(rim.points_px, rim.found.astype(np.float64), circles)
    used = rim.found & _near(rim.points_px, rim.found, fitted)
    fitted, residual = fit_circles(rim.points_px, used.astype(np.float64), fitted)
    support = used.sum(axis=1) / np.maximum(rim.visible.sum(axis=1), _MIN_POINTS)
    return _Rims(fitted, residual, used.mean(axis=1), support, (used * rim.fall).mean(axis=1))


def _best_discs(contrast: NDArray[np.float32], circles: NDArray[np.float64], params: DetectionParams) -> _Rims:
    """Refine the circles and keep those that are discs, of several in one place the best."""
    rims = _refine(contrast, circles, params)
    discs = np.flatnonzero(_is_disc(rims, params))
    best = discs[_best_apart(rims.circles[discs], rims.merit[discs])]
    return _Rims(*(column[best] for column in rims))


def _is_disc(rims: _Rims, params: DetectionParams) -> NDArray[np.bool_]:
    return np.asarray(
        _of_size(rims.circles, params)
        & (rims.residual <= params.max_residual * rims.circles[:, 2])
        & (rims.arc >= np.maximum(params.min_arc_fraction, _LEAST_ARC_PX / (2 * np.pi * rims.circles[:, 2])))
        & (rims.support >= params.min_support)
    )


def _near(points: NDArray[np.float64], found: NDArray[np.bool_], circles: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (D, R, 2) lie no farther from their circle than three robust standard deviations."""
    distance = np.abs(_distance(points, circles))
    ordered = np.sort(np.where(found, distance, np.inf), axis=1)
    median = ordered[np.arange(len(found)), found.sum(axis=1) // 2 - 1]
    return np.asarray(distance <= np.maximum(3 * 1.4826 * median, 0.1)[:, None])


def _of_size(circles: NDArray[np.float64], params: DetectionParams) -> NDArray[np.bool_]:
    return (circles[:, 2] >= params.min_radius_px) & (circles[:, 2] <= params.max_radius_px)


def _best_apart(circles: NDArray[np.float64], merit: NDArray[np.float64]) -> list[int]:
    """Indices of circles that do not overlap, best merit first: discs lie side by side."""
    rivals = overlapping(circles, circles)
    kept: list[int] = []
    for i in np.argsort(-merit, kind="stable"):
        if not rivals[i, kept].any():
            kept.append(int(i))
    return kept
