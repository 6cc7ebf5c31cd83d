"""First stages of the chain: the colour frame becomes a small grey image.

A decoder that can scale while it decodes does the same in less time; `to_full_px` holds for both, because each
small pixel is the mean of a block of `factor` x `factor` pixels and its centre is the centre of that block.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["subsample", "to_full_px"]


def subsample(frame: NDArray[np.uint8], factor: int = 4) -> NDArray[np.uint8]:
    """Average blocks of a BGR (H, W, 3) or grey (H, W) frame and return it as grey (H // factor, W // factor)."""
    height, width = frame.shape[0] // factor, frame.shape[1] // factor
    whole_blocks = frame[: height * factor, : width * factor]
    small = cv2.resize(whole_blocks, (width, height), interpolation=cv2.INTER_AREA)
    grey = small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
    return np.asarray(grey, dtype=np.uint8)


def to_full_px(small_px: NDArray[np.float64], factor: int = 4) -> NDArray[np.float64]:
    """Coordinates in the small image -> coordinates in the frame; a pixel's centre has whole coordinates."""
    return factor * small_px + (factor - 1) / 2
