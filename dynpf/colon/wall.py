"""The wall of a map as what may be displaced: nodes along it, and which of them a point belongs to."""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import exp, hypot, whole
from dynpf.types import Float32s, Int32s

__all__ = ["Wall"]


_BULGES = 2  # places of bulges to a node
_REACH = 2.5  # standard deviations of a bell after which nothing is left of it


class Wall(NamedTuple):
    """Nodes along the walls of a bore, J in all, each wall a ring.

    ``beyond`` (H, W): how far, in cells, the middle of a cell lies beyond the nearest wall, negative inside.
    ``node``, ``share`` (H, W): the nearest point of a wall lies between ``node`` and the one ``following`` (J,) it,
    ``share`` of the way on. ``places`` (2, J): column and row of each node. ``prior`` (J, J): covariance of the nodes'
    displacements across the wall, in cells^2: a Gaussian process along the wall. ``shapes`` (S, J): how far bulges move
    the nodes, each a bell, of height one, at another place; ``near`` (J, W): those that reach farthest at each node.
    """

    beyond: Float32s
    node: Int32s
    share: Float32s
    following: Int32s
    places: Int32s
    prior: Float32s
    shapes: Float32s
    near: Int32s

    @classmethod
    def of(cls, bore: OccupancyGrid, spacing: float, length: float, deviation: float, width: float = 40.0) -> "Wall":
        """Return the wall of a bore with nodes about ``spacing`` cells apart.

        ``length`` (cells): how far along the wall displacements are alike; ``deviation`` (cells): their standard one;
        ``width`` (cells): the standard deviation of a bulge's bell.
        """
        free = bore.free
        # Between the middles of two cells, one in the wall and one not, is the wall's surface: half a cell from each.
        beyond = np.where(free, 0.5 - distance_field(~free, 1.0), distance_field(free, 1.0) - 0.5)
        contours, _ = cv2.findContours(free.astype(np.uint8, casting="safe"), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        rings = [_ring(contour[:, 0].astype(np.int32, casting="same_kind"), spacing) for contour in contours]
        first = np.cumsum([0, *(ring.nodes for ring in rings)])
        points = np.concatenate([ring.points for ring in rings])
        node = np.concatenate([ring.node + start for ring, start in zip(rings, first, strict=False)])
        nearest = _nearest(points, free.shape)
        following = np.concatenate(
            [start + (np.arange(ring.nodes) + 1) % ring.nodes for ring, start in zip(rings, first, strict=False)]
        )
        prior = np.zeros((first[-1], first[-1]))
        shapes = np.zeros((_BULGES * first[-1], first[-1]))
        for ring, start in zip(rings, first, strict=False):
            own = slice(start, start + ring.nodes)
            prior[own, own] = deviation * deviation * _alike(ring, np.arange(ring.nodes), length)
            places = np.arange(_BULGES * ring.nodes) / _BULGES
            shapes[_BULGES * start : _BULGES * (start + ring.nodes), own] = _alike(ring, places, width)
        following_shapes = np.maximum(shapes, shapes[:, following])
        count = min(math.ceil(_BULGES * (2.0 * _REACH * width / spacing + 2.0)), len(shapes))
        near = np.argsort(-following_shapes, axis=0, kind="stable")[:count].T
        return cls(
            beyond.astype(np.float32),
            node.astype(np.int32, casting="same_kind")[nearest],
            np.concatenate([ring.share for ring in rings]).astype(np.float32)[nearest],
            following.astype(np.int32, casting="same_kind"),
            np.concatenate([ring.points[ring.starts] for ring in rings]).T.astype(np.int32, casting="same_kind"),
            prior.astype(np.float32),
            shapes.astype(np.float32),
            np.ascontiguousarray(near).astype(np.int32, casting="same_kind"),
        )


class _Ring(NamedTuple):
    """Points (M, 2) around a wall, the node before each and the way on from it, and the points that are nodes."""

    points: Int32s
    node: NDArray[np.int64]
    share: NDArray[np.float64]
    starts: NDArray[np.int64]
    nodes: int
    circumference: float


def _ring(points: Int32s, spacing: float) -> _Ring:
    lengths = hypot(*(np.roll(points, -1, axis=0) - points).T)
    along, circumference = np.append(0.0, np.cumsum(lengths)[:-1]), max(float(lengths.sum()), 1.0)
    nodes = max(round(circumference / spacing), 1)
    position = along * nodes / circumference
    node = whole(position, 0, nodes)
    starts = np.searchsorted(position, np.arange(nodes))
    return _Ring(points, node, position - node, starts, nodes, circumference)


def _alike(ring: _Ring, positions: NDArray[np.float64] | NDArray[np.int64], length: float) -> NDArray[np.float64]:
    """Return a bell (P, J) of the distances along a ring between positions (P,), in nodes, and its nodes."""
    steps = np.abs(positions[:, None] - np.arange(ring.nodes))
    distance = np.minimum(steps, ring.nodes - steps) * ring.circumference / ring.nodes
    alike: NDArray[np.float64] = exp(-0.5 * np.square(distance / length))
    return alike


def _nearest(points: Int32s, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return for each cell (H, W) the index of the nearest of points (M, 2), column and row, to within half a cell."""
    away = np.ones(shape, dtype=np.uint8)
    away[points[:, 1], points[:, 0]] = 0
    _, labels = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(labels.max() + 1, dtype=np.int64)
    # A point that a thin wall passes twice keeps the later index.
    of_label[labels[points[:, 1], points[:, 0]]] = np.arange(len(points))
    nearest: NDArray[np.int64] = of_label[labels]
    return nearest
