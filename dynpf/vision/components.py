"""Threshold, connected components, and the circles that arcs of their borders lie on.

A disc that touches another, is cut by the image's border or melts into a shadow has a border of which only arcs are
its rim. So circles are fitted to arcs of every length, and one after another those are taken that the most of the
border lies on, which then is spoken for.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.portable import norm, whole
from dynpf.vision.circle import fit_circles_algebraic

__all__ = ["Borders", "arc_circles", "foreground", "trace_borders"]


_CLUTTER = 256
_SHORTEST_ARC = 10  # border pixels; the next are twice as long each
_STRIDES = 4  # arcs of one length start this many to a length
_NEAR_PX = 1.0  # a border pixel this close lies on the circle
_FACING = 0.8  # cosine between a border's normal and the direction to the centre
_ARC_RMS_PX = 0.45  # of border pixels to the rim they follow
_LEAST_SHARE = 0.12  # of a circumference, that border pixels must lie on


class Borders(NamedTuple):
    """The border pixels of an image's components, contour after contour, each in order.

    ``px`` (K, 2) x, y; ``inward`` (K, 2) unit normals into the component; ``edge`` (K,) whether the pixel is an edge
    and not the image's border; ``component`` (K,) whose it is, from 0; ``outer`` (K,) whether it is on the outside of
    it, not in a hole; ``lengths`` those of the contours.
    """

    px: NDArray[np.float64]
    inward: NDArray[np.float64]
    edge: NDArray[np.bool_]
    component: NDArray[np.intp]
    outer: NDArray[np.bool_]
    lengths: tuple[int, ...]


def foreground(contrast: NDArray[np.float32], min_contrast: float) -> NDArray[np.uint8]:
    """Return the mask (H, W; 255 or 0) of what stands out from the background, darker or lighter.

    A pixel belongs to it when it has half of the strongest contrast within 3 px, so that the border runs where the
    edge has its half height whatever the disc's grey.
    """
    strength = whole(np.rint(np.abs(contrast)), 0, 255, np.uint8)
    noise = 1.4826 * float(np.median(strength[::4, ::4]))
    floor = max(0.5 * min_contrast, 5 * noise)
    strongest = np.asarray(cv2.dilate(strength, np.ones((7, 7), np.uint8)))
    stands_out = (strength > strongest // 2) & (strength > floor)
    return stands_out.astype(np.uint8, casting="safe") * np.uint8(255)


def trace_borders(mask: NDArray[np.uint8], min_area_px: float) -> Borders:
    """Follow the borders of the mask's components (Suzuki and Abe 1985); specks below ``min_area_px`` are passed over.

    An image with more than 256 components is clutter, in which nothing is found.
    """
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parents = [int(row[3]) for row in hierarchy[0]] if contours else []
    large = [len(contour) >= _SHORTEST_ARC and cv2.contourArea(contour) >= min_area_px for contour in contours]
    owners = {i: number for number, i in enumerate(i for i, parent in enumerate(parents) if parent < 0 and large[i])}
    if len(owners) > _CLUTTER:
        owners = {}
    chosen = [
        (np.asarray(contours[i], dtype=np.float64)[:, 0], owners[i if parent < 0 else parent], parent < 0)
        for i, parent in enumerate(parents)
        if (i if parent < 0 else parent) in owners and len(contours[i]) >= _SHORTEST_ARC
    ]
    lengths = tuple(len(points) for points, _, _ in chosen)
    px = np.concatenate([np.zeros((0, 2)), *(points for points, _, _ in chosen)])
    last = np.array(mask.shape[::-1]) - 1
    return Borders(
        px=px,
        inward=np.concatenate([np.zeros((0, 2)), *(_normals(points, outer) for points, _, outer in chosen)]),
        edge=np.asarray(((px > 0) & (px < last)).all(axis=1)),
        component=np.repeat(np.array([owner for _, owner, _ in chosen], dtype=np.intp), lengths),
        outer=np.repeat(np.array([outer for _, _, outer in chosen], dtype=bool), lengths),
        lengths=lengths,
    )


def arc_circles(
    borders: Borders, wanted: NDArray[np.bool_], min_radius_px: float, max_radius_px: float
) -> NDArray[np.float64]:
    """Return circles (D, 3) that arcs of the borders of the components ``wanted`` (C,) lie on."""
    circles, component = _circles_through_arcs(borders, wanted, min_radius_px, max_radius_px)
    found = [np.zeros((0, 3))]
    for number in np.flatnonzero(wanted):
        mine = (borders.component == number) & borders.edge
        found.append(_best_supported(circles[component == number], borders.px[mine], borders.inward[mine]))
    return np.concatenate(found)


def _circles_through_arcs(
    borders: Borders, wanted: NDArray[np.bool_], min_radius_px: float, max_radius_px: float
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Circles (D, 3) through arcs that fit them, and whose arcs they are (D,)."""
    circles, component = [np.zeros((0, 3))], [np.zeros(0, dtype=np.intp)]
    length = _SHORTEST_ARC
    while length <= max(borders.lengths, default=0):
        at = _windows(borders, wanted, length)
        points, weights = borders.px[at], borders.edge[at].astype(np.float64)
        fitted = fit_circles_algebraic(points, weights)
        towards = fitted[:, None, :2] - points
        distance = np.maximum(norm(towards, axis=2), 1e-9)
        total = np.maximum(weights.sum(axis=1), 1e-9)
        rms = np.sqrt((weights * np.square(distance - fitted[:, 2, None])).sum(axis=1) / total)
        facing = (weights * (towards * borders.inward[at]).sum(axis=2) / distance).sum(axis=1) / total
        good = (
            (total >= _SHORTEST_ARC / 2)
            & (rms <= _ARC_RMS_PX)
            & (facing > _FACING)
            & (fitted[:, 2] >= min_radius_px - 1)
            & (fitted[:, 2] <= max_radius_px + 1)
        )
        circles.append(fitted[good])
        component.append(borders.component[at[good, 0]])
        length *= 2
    return np.concatenate(circles), np.concatenate(component)


def _windows(borders: Borders, wanted: NDArray[np.bool_], length: int) -> NDArray[np.intp]:
    """Indices (D, length) of arcs along the closed contours of the components wanted."""
    windows, start = [np.zeros((0, length), dtype=np.intp)], 0
    for count in borders.lengths:
        if count >= length and wanted[borders.component[start]]:
            first = np.arange(0, count, max(length // _STRIDES, 1))
            windows.append(start + (first[:, None] + np.arange(length)) % count)
        start += count
    return np.concatenate(windows)


def _best_supported(
    circles: NDArray[np.float64], px: NDArray[np.float64], inward: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Choose circles one by one: that on which the most border pixels lie which none before it has claimed."""
    towards = circles[:, None, :2] - px
    distance = np.maximum(norm(towards, axis=2), 1e-9)
    facing = (towards * inward).sum(axis=2) > _FACING * distance
    lies_on = (np.abs(distance - circles[:, 2, None]) <= _NEAR_PX) & facing
    least = np.maximum(_SHORTEST_ARC / 2, _LEAST_SHARE * 2 * np.pi * circles[:, 2])
    chosen: list[int] = []
    free = np.ones(len(px), dtype=bool)
    while len(chosen) < _CLUTTER:
        support = (lies_on & free).sum(axis=1)
        support[support < least] = 0
        if len(circles) == 0 or support.max() == 0:
            break
        best = int(np.argmax(support))
        chosen.append(best)
        free &= ~lies_on[best]
    return circles[chosen]


def _normals(points: NDArray[np.float64], outer: bool) -> NDArray[np.float64]:
    """Unit normals (n, 2) of a closed contour into the component, from its tangent over seven pixels."""
    after, before = np.roll(points, -3, axis=0), np.roll(points, 3, axis=0)
    tangent = after - before
    following = np.roll(points, -1, axis=0)
    area = float((points[:, 0] * following[:, 1] - following[:, 0] * points[:, 1]).sum())
    side = 1.0 if (area > 0) == outer else -1.0
    normal = side * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return np.asarray(normal / np.maximum(norm(normal, axis=1), 1e-9)[:, None])
