"""Threshold, connected components, and the cut of a component into discs that touch.

Discs do not overlap, so two that touch are joined by a neck much thinner than either: the distance of a pixel to
the component's outside has one peak per disc, near its centre and about as high as its radius. The component's
edge pixels go to the peak whose circle passes nearest; that is the contour cut at its concave points.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Group", "foreground", "group_edges"]


_CLUTTER = 256


class Group(NamedTuple):
    """The edge pixels of an image and whose they are, as weights 1 or 0."""

    edge_px: NDArray[np.float64]  # (K, 2) x, y
    of_component: NDArray[np.float64]  # (C, K) the outer border of each component
    of_peak: NDArray[np.float64]  # (D, K) the share of each peak in its component's borders
    component: NDArray[np.intp]  # (D,) the component that each peak is in


def foreground(contrast: NDArray[np.float32], min_contrast: float) -> NDArray[np.uint8]:
    """Return the mask (H, W; 255 or 0) of what stands out from the background, darker or lighter.

    A pixel belongs to it when it has half of the strongest contrast within 3 px, so that the border runs where the
    edge has its half height whatever the disc's grey.
    """
    strength = np.asarray(cv2.convertScaleAbs(contrast))
    noise = 1.4826 * float(np.median(strength[::4, ::4]))
    floor = max(0.5 * min_contrast, 5 * noise)
    strongest = np.asarray(cv2.dilate(strength, np.ones((7, 7), np.uint8)))
    stands_out = (strength > strongest // 2) & (strength > floor)
    return stands_out.astype(np.uint8) * np.uint8(255)


def group_edges(mask: NDArray[np.uint8], min_radius_px: float) -> Group:
    """Find the mask's components and the discs in each, and hand out the edge pixels.

    Specks of less than half the area of the smallest disc are passed over. A hole as small as that is either a glint
    on a disc or what three discs leave between them: peaks are found both with such holes filled and with them open,
    and it is left to the fit which are discs. The image's border is no edge. An image with more than 256 components
    or peaks is clutter, in which nothing is found.
    """
    borders = _borders(mask, np.pi * min_radius_px**2 / 2)
    names = np.unique(borders.label)
    if len(names) > _CLUTTER:
        return _nothing(borders.px)
    of_component = (borders.label == names[:, None]) & borders.outer
    of_peak, component = [np.zeros((0, len(borders.px)), dtype=bool)], [np.zeros(0, dtype=np.intp)]
    has_holes = bool(((borders.filled > 0) & (mask == 0)).any())
    for labels in (borders.filled, np.where(mask > 0, borders.filled, 0))[: 1 + has_holes]:
        peak_px, peak_radius = _peaks(labels, min_radius_px)
        if len(peak_px) > _CLUTTER:
            return _nothing(borders.px)
        peak_label = labels[peak_px[:, 1], peak_px[:, 0]]
        of_peak.append(_shares(borders, peak_px, peak_radius, peak_label))
        component.append(np.searchsorted(names, peak_label))
    return Group(
        borders.px, of_component.astype(float), np.concatenate(of_peak).astype(float), np.concatenate(component)
    )


def _nothing(edge_px: NDArray[np.float64]) -> Group:
    none = np.zeros((0, len(edge_px)))
    return Group(edge_px, none, none, np.zeros(0, dtype=np.intp))


class _Borders(NamedTuple):
    px: NDArray[np.float64]  # (K, 2) edge pixels, x, y
    label: NDArray[np.int32]  # (K,) the component of each
    outer: NDArray[np.bool_]  # (K,) whether it belongs to the outer border
    filled: NDArray[np.int32]  # (H, W) component of each pixel, small holes included; 0: none


def _borders(mask: NDArray[np.uint8], min_area_px: float) -> _Borders:
    """Label the components by following their borders (Suzuki and Abe 1985)."""
    contours, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parents = [int(row[3]) for row in hierarchy[0]] if contours else []
    large = [len(contour) > 4 and cv2.contourArea(contour) >= min_area_px for contour in contours]
    kept = [i for i, parent in enumerate(parents) if large[i] and (parent < 0 or large[parent])]
    filled = np.zeros(mask.shape, dtype=np.int32)
    edges, labels = [np.zeros((0, 2))], [np.zeros(0, dtype=np.int32)]
    outer = [np.zeros(0, dtype=bool)]
    last = np.array(mask.shape[::-1]) - 1
    for i in sorted(kept, key=lambda i: parents[i] >= 0):  # holes are cut after what they are in is filled
        is_outer = parents[i] < 0
        label = 1 + (i if is_outer else parents[i])
        cv2.drawContours(filled, contours, i, float(label if is_outer else 0), cv2.FILLED)
        edge = np.asarray(contours[i], dtype=np.float64)[:, 0]
        edge = edge[((edge > 0) & (edge < last)).all(axis=1)]
        edges.append(edge)
        labels.append(np.full(len(edge), label, dtype=np.int32))
        outer.append(np.full(len(edge), is_outer))
    return _Borders(np.concatenate(edges), np.concatenate(labels), np.concatenate(outer), filled)


def _shares(
    borders: _Borders,
    peak_px: NDArray[np.int64],
    peak_radius: NDArray[np.float64],
    peak_label: NDArray[np.int32],
) -> NDArray[np.bool_]:
    """Which edge pixels (D, K) are nearer to each peak's circle than to any other's in the same component."""
    if len(peak_px) == 0:
        return np.zeros((0, len(borders.px)), dtype=bool)
    distance = np.sqrt(((borders.px - peak_px[:, None]) ** 2).sum(axis=2)) - peak_radius[:, None]
    distance = np.where(borders.label == peak_label[:, None], np.abs(distance), np.inf)
    owner = np.argmin(distance, axis=0)
    close = distance[owner, np.arange(len(borders.px))] < 0.5 * peak_radius[owner]
    return np.asarray((owner == np.arange(len(peak_px))[:, None]) & close)


def _peaks(labels: NDArray[np.int32], min_radius_px: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Peaks of the distance to the outside, x, y (D, 2) and height (D,); one within each peak's own radius."""
    inside = (labels > 0).astype(np.uint8)
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_5)
    highest = cv2.dilate(depth, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero((depth >= highest) & (depth > 0.7 * min_radius_px))
    height = depth[rows, columns].astype(np.float64)
    kept: list[int] = []
    for candidate in np.argsort(-height, kind="stable"):
        clear = all(
            np.hypot(rows[candidate] - rows[other], columns[candidate] - columns[other]) > height[other]
            for other in kept
        )
        if clear:
            kept.append(int(candidate))
        if len(kept) > _CLUTTER:
            break
    return np.stack([columns[kept], rows[kept]], axis=1), height[kept]
