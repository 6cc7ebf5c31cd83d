"""Parameters of the vision process."""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.types import NonNegative
from dynpf.vision import (
    Board,
    Calibration,
    CalibrationError,
    DetectionParams,
    Disc,
    calibrate,
    find_board,
    to_full_px,
)

__all__ = ["VisionConfig"]

Pair = tuple[float, float, float, float]  # u_px, v_px, x_m, y_m
Side = Annotated[int, Meta(ge=64, le=4096, multiple_of=4)]


class VisionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The format of the frames, the detection of discs in them, and the calibration of pixels to the workspace."""

    width_px: Side = 1280
    height_px: Side = 1024
    detection: DetectionParams = DetectionParams()
    calibration: Annotated[tuple[Pair, ...], Meta(min_length=6)] | Board | None = None
    """Known points as [u_px, v_px, x_m, y_m], or the board that the first frame shows (`simulator.camera.board`). One
    of them has to be given."""
    position_noise_m: NonNegative | None = None
    """Standard deviation of Gaussian noise added to each coordinate: the measurement noise that PARTS assumes, which a
    sharp frame lacks. Absent: that of the task's noise; without a task, none."""

    def __post_init__(self) -> None:
        """Refuse calibration pairs that fix no map: CalibrationError, a ValueError."""
        if isinstance(self.calibration, tuple):
            self.calibrated()

    def calibrated(self, board_discs: Sequence[Disc] = (), subsampling: int = 1) -> Calibration:
        """Return the map from pixels of the frame to the workspace, from the pairs or from a board's discs in view.

        The discs are those of the frame subsampled by ``subsampling``. Raises CalibrationError.
        """
        centre_px = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        if isinstance(self.calibration, Board):
            small_px, points_m = find_board(board_discs, self.calibration)
            return calibrate(to_full_px(small_px, subsampling), points_m, centre_px)
        if self.calibration is None:
            raise CalibrationError("vision needs a calibration: known points, or a board")
        pairs = np.array(self.calibration)
        return calibrate(pairs[:, :2], pairs[:, 2:], centre_px)
