"""How like two pictures of a page are to the eye: small and blurred, so that fonts and single lines do not count."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["ALIKE", "keep", "unlike"]

KEPT_WIDTH = 280
SIDE = 48
ALIKE = 0.06
"""Pictures that differ less are taken for the same: of one page 0.02, of two pages of a system above 0.1."""


def keep(shot: Path, kept: Path) -> None:
    """Keep a picture, small."""
    picture = _read(shot)
    height = round(picture.shape[0] * KEPT_WIDTH / picture.shape[1])
    small = cv2.resize(picture, (KEPT_WIDTH, height), interpolation=cv2.INTER_AREA)
    kept.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(kept), small, [cv2.IMWRITE_JPEG_QUALITY, 80])


def unlike(one: Path, other: Path) -> float:
    """Return how much the tenth of two pictures' blocks that differ most do, from 0 to 1.

    Blocks are compared in Lab, whose steps are as large as the eye takes them to be.
    """
    apart = np.sort(np.abs(_blocks(one) - _blocks(other)).max(axis=2), axis=None)
    return float(apart[-(apart.size // 10) :].mean())


def _blocks(path: Path) -> NDArray[np.float32]:
    picture = cv2.cvtColor(_read(path), cv2.COLOR_BGR2LAB).astype(np.float32) / 255.0
    return cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)


def _read(path: Path) -> NDArray[np.uint8]:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert picture is not None, path
    return np.asarray(picture, dtype=np.uint8)
