"""Parameters of the vision process."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.vision import Calibration, DetectionParams, calibrate
from services.simulator.camera import CameraParams, calibration_pairs

__all__ = ["VisionConfig"]

Pair = tuple[float, float, float, float]  # u_px, v_px, x_m, y_m
Side = Annotated[int, Meta(ge=64, le=4096, multiple_of=4)]


def _default_pairs() -> tuple[Pair, ...]:
    """A session with a board under the camera that is simulated by default, free of error."""
    return tuple((u, v, x, y) for u, v, x, y in calibration_pairs(CameraParams()))


class VisionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the frames are like, how discs are told in them, and where pixels lie in the workspace."""

    width_px: Side = 1280
    height_px: Side = 1024
    detection: DetectionParams = DetectionParams()
    calibration: Annotated[tuple[Pair, ...], Meta(min_length=6)] = msgspec.field(default_factory=_default_pairs)
    position_noise_m: Annotated[float, Meta(ge=0.0)] | None = None
    """Standard deviation of Gaussian noise added to each coordinate: the measurement noise that PARTS assumes, which a
    sharp frame lacks. Absent: that of the task's noise; without a task, none."""

    def __post_init__(self) -> None:
        """Refuse calibration pairs that fix no map: CalibrationError, a ValueError."""
        self.calibrated()

    def calibrated(self) -> Calibration:
        """Return the map from pixels of the frame to the workspace."""
        pairs = np.array(self.calibration)
        centre_px = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        return calibrate(pairs[:, :2], pairs[:, 2:], centre_px)
