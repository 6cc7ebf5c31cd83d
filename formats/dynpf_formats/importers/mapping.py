"""An occupancy map from a log's own scans at their reference poses: the counting model.

A cell counts how many scans have a beam that ends in it, and how many have one that passes through it. It is occupied
if the share of ends is large enough, free if it is smaller, unknown if no beam reached it. Of the occupied cells those
that no free one touches become unknown: noise puts ends behind a wall's face, where no beam ever passes, and a map with
such walls draws a robot towards them.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from dynpf_protocol.messages import LaserScan, RobotState, heading
from numpy.typing import NDArray

from dynpf.maps.occupancy import faces
from dynpf.portable import sincos, whole
from dynpf.types import FloatArray
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import Record
from dynpf_formats.importers.poses import Pose, compose
from dynpf_formats.recording.attachments import attached
from dynpf_formats.recording.header import Attachment

__all__ = ["drawn_map"]

FAR_M = 30.0  # longer beams are not used
OCCUPIED_SHARE = 0.25  # of ends among ends and passages
MARGIN_M = 1.0  # around everything seen
LARGEST = 2**27  # cells
OCCUPIED, FREE, UNKNOWN = 0, 254, 205  # pixels, as map_saver writes them

Cells = NDArray[np.int64]


class _Beams(NamedTuple):
    """A scan on the map: the sensor's position (2,), the beams' directions (B, 2), lengths (B,) in metres."""

    origin: FloatArray
    directions: FloatArray
    lengths: FloatArray


def drawn_map(records: Callable[[], Iterable[Record]], resolution: float, name: str) -> tuple[Attachment, ...]:
    """Return the map of a log, its cells ``resolution`` metres wide, as the files ``name``.yaml and ``name``.pgm.

    Each call of ``records`` gives the log's records from the start. Every scan that follows a reference pose with the
    same stamp is used. Raises ImportFailedError if there is none, or if the area is too large.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for beams in _placed(records()):
        ends = np.concatenate([_ends(beams), beams.origin[None]])
        low, high = np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))
    if not np.isfinite(low).all():
        raise ImportFailedError("the log has no scan with a reference pose of its own: no map can be drawn from it")
    low = np.floor((low - MARGIN_M) / resolution) * resolution
    width, height = whole(np.ceil((high + MARGIN_M - low) / resolution), 1, 2**40).tolist()
    if width * height > LARGEST:
        raise ImportFailedError(f"a map of {width} x {height} cells is too large; expected at most {LARGEST}")

    hits, passages = np.zeros(width * height, np.int32), np.zeros(width * height, np.int32)

    def cells(points: FloatArray) -> Cells:
        cell = np.floor((points - low) / resolution)
        column, row = whole(cell[:, 0], 0, width - 1), whole(cell[:, 1], 0, height - 1)
        return np.unique(row * width + column)

    for beams in _placed(records()):
        ended = cells(_ends(beams))
        hits[ended] += 1
        passages[np.setdiff1d(cells(_passed(beams, resolution)), ended, assume_unique=True)] += 1
    looked = hits + passages
    pixels = np.full(width * height, UNKNOWN, np.uint8)
    pixels[looked > 0] = FREE
    walls = hits > OCCUPIED_SHARE * looked
    shape = height, width
    pixels[walls] = UNKNOWN
    pixels[faces(walls.reshape(shape), ((looked > 0) & ~walls).reshape(shape)).ravel()] = OCCUPIED
    image = f"P5\n{width} {height}\n255\n".encode() + pixels.reshape(height, width)[::-1].tobytes()
    x, y = low.tolist()
    text = (
        f"image: {name}.pgm\nresolution: {resolution!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return attached(f"{name}.yaml", text.encode()), attached(f"{name}.pgm", image)


def _placed(records: Iterable[Record]) -> Iterator[_Beams]:
    pose: Pose | None = None
    since_ns = -1
    for record in records:
        match record.message:
            case RobotState(x=x, y=y, theta=theta):
                pose, since_ns = (x, y, theta), record.stamp_ns
            case LaserScan() as scan if pose is not None and since_ns == record.stamp_ns:
                yield _beams(pose, scan)


def _beams(pose: Pose, scan: LaserScan) -> _Beams:
    at = scan.pose.position
    x, y, theta = compose(pose, (at.x, at.y, heading(scan.pose.orientation)))
    lengths = np.array(scan.ranges)
    angles = theta + np.linspace(scan.start_angle, scan.end_angle, len(lengths))
    kept = (lengths > 0.0) & (lengths < min(FAR_M, float(lengths.max())))
    sines, cosines = sincos(angles[kept])
    directions = np.stack([cosines, sines], axis=1)
    return _Beams(np.array([x, y]), directions, lengths[kept])


def _ends(beams: _Beams) -> FloatArray:
    return beams.origin + beams.lengths[:, None] * beams.directions


def _passed(beams: _Beams, resolution: float) -> FloatArray:
    """Return points half a cell apart along the beams, up to a cell before their ends, shape (P, 2)."""
    step_m = resolution / 2
    farthest = max(float(beams.lengths.max(initial=0.0)) - resolution, 0.0)
    count = math.ceil(farthest / step_m)
    steps = step_m * np.arange(count)
    beam, step = np.nonzero(steps[None, :] < beams.lengths[:, None] - resolution)
    return beams.origin + steps[step, None] * beams.directions[beam]
