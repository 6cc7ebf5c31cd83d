"""What OpenCV's functions give, as digests: `python -m checks.opencv_bits` prints one a function, and of a control.

Portable code uses these functions with arrays of other types than whole numbers, or with instructions that OpenCV and
the libraries beneath it choose by processor. With which of them a process runs, environment variables say, so that
a test can compare. Each function is called with its images at all places within 64 bytes.
"""

import hashlib
import json
import sys
from collections.abc import Callable, Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["CONTROL", "PORTABLE", "digests"]

Image = NDArray[np.uint8]
_ALIGNMENTS = 64


def _noise(*shape: int) -> Image:
    """Return numbers from 0 to 255, by integer arithmetic."""
    mixed = np.arange(1, np.prod(shape) + 1, dtype=np.uint64) * np.uint64(0x5851F42D4C957F2D)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return (mixed >> np.uint64(56)).astype(np.uint8).reshape(shape)


def _patches(colours: int) -> Image:
    """Return an image of flat patches with some noise, which a JPEG file holds well."""
    patches = (
        np.kron(_noise(13, 21, colours) // 2, np.ones((8, 8, 1), dtype=np.uint8)) + _noise(104, 168, colours) // 16
    )
    return np.ascontiguousarray(patches[:101, :163].squeeze())


def _file(kind: str, image: Image) -> Image:
    params = [cv2.IMWRITE_JPEG_QUALITY, 85] if kind == ".jpg" else []
    return np.frombuffer(cv2.imencode(kind, image, params)[1], np.uint8)


def _shrunk(factor: int) -> Callable[[Image], Any]:
    def shrink(image: Image) -> Any:
        height, width = image.shape[0] // factor, image.shape[1] // factor
        whole_blocks = image[: height * factor, : width * factor]
        return cv2.resize(whole_blocks, (width, height), interpolation=cv2.INTER_AREA)

    return shrink


def _contours(mask: Image) -> Any:
    return cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)[0]


def _labels(away: Image) -> Any:
    return cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]


def _quadrilaterals(numbers: Image) -> Iterable[Image]:
    for quad in numbers.reshape(-1, 4, 2).astype(np.int32) * 32749:
        filled = np.zeros((140, 140), dtype=np.uint8)
        cv2.fillConvexPoly(filled, cv2.convexHull(quad), (1,), cv2.LINE_8, 16)
        yield filled


def _circles(numbers: Image) -> Iterable[Image]:
    for x, y, radius in numbers.reshape(-1, 3).tolist():
        filled = np.zeros((140, 140), dtype=np.uint8)
        cv2.circle(filled, (x * 32749, y * 32749), radius * 8191, 1, -1, cv2.LINE_8, 16)
        yield filled


_BLOBS = np.kron(_noise(31, 43) // 128, np.ones((4, 4), dtype=np.uint8))

PORTABLE: dict[str, tuple[Callable[[Image], Any], Image]] = {
    "JPEG written": (lambda image: _file(".jpg", image), _patches(3)),
    "JPEG read": (lambda data: cv2.imdecode(data, cv2.IMREAD_UNCHANGED), _file(".jpg", _patches(3))),
    "JPEG read at a quarter": (
        lambda data: cv2.imdecode(data, cv2.IMREAD_REDUCED_GRAYSCALE_4),
        _file(".jpg", _patches(3)),
    ),
    "PNG read": (lambda data: cv2.imdecode(data, cv2.IMREAD_UNCHANGED), _file(".png", _patches(3))),
    **{f"shrunk {factor} times": (_shrunk(factor), _noise(101, 163, 3)) for factor in (2, 3, 4, 7)},
    **{f"grey, shrunk {factor} times": (_shrunk(factor), _noise(101, 163)) for factor in (2, 3, 4, 7)},
    "grey": (lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), _noise(101, 163, 3)),
    "dilated": (lambda image: cv2.dilate(image, np.ones((7, 7), np.uint8)), _noise(101, 163)),
    "components": (lambda mask: cv2.connectedComponents(mask, connectivity=4)[1], _BLOBS),
    "components' sizes": (lambda mask: cv2.connectedComponentsWithStats(mask, connectivity=8)[1:3], _BLOBS),
    "contours": (_contours, _BLOBS),
    "areas": (lambda mask: [np.float64(cv2.contourArea(one)) for one in _contours(mask)], _BLOBS),
    "polygons": (lambda mask: [cv2.approxPolyDP(one, 1.0, closed=True) for one in _contours(mask)], _BLOBS),
    "nearest pixels": (_labels, (_noise(101, 163) > 1).astype(np.uint8)),
    "quadrilaterals": (_quadrilaterals, _noise(40, 8)),
    "circles": (_circles, _noise(40, 3)),
}
CONTROL = "control: directions, a linear resize and a logarithm in float32"


def digests() -> dict[str, str]:
    """Return the digest of what each function gives, and of the control; "differs" where it depends on alignment."""
    found = {name: _digest_at_all_places(function, image) for name, (function, image) in PORTABLE.items()}
    numbers = _noise(101, 163).astype(np.float32) + np.float32(1.0)
    control = cv2.phase(numbers, numbers[::-1].copy()), cv2.resize(numbers, (71, 41)), cv2.log(numbers)
    return found | {CONTROL: _digest(control)}


def _digest_at_all_places(function: Callable[[Image], Any], image: Image) -> str:
    room = np.empty(image.nbytes + 2 * _ALIGNMENTS, dtype=np.uint8)
    found = set()
    for place in range(_ALIGNMENTS):
        start = -room.ctypes.data % _ALIGNMENTS + place
        moved = room[start : start + image.nbytes].reshape(image.shape)
        moved[...] = image
        found.add(_digest(function(moved)))
    return found.pop() if len(found) == 1 else "differs"


def _digest(results: Any) -> str:
    digest = hashlib.sha256()
    for result in [results] if isinstance(results, np.ndarray) else results:
        digest.update(np.ascontiguousarray(result).tobytes())
    return digest.hexdigest()


def main() -> int:
    print(json.dumps(digests(), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
