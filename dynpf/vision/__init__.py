"""Overhead vision: from a grey image to discs in the workspace (PARTS section 5.2).

One module a stage, in the order of the chain: `subsample`, `background` (the light), `components` (threshold,
connected components, arcs), `edges` (to a fraction of a pixel), `circle` (the fit), `discs` (the chain and
what is rejected), `projection`, `calibration` and `board` (pixels to metres).
"""

try:
    import cv2  # noqa: F401 - an extra of the library, asked for by name before its modules need it
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("dynpf.vision needs OpenCV: pip install 'dynpf[vision]'", name="cv2") from error

from dynpf.vision.board import Board, find_board
from dynpf.vision.calibration import Calibration, CalibrationError, WorkspaceDisc, calibrate
from dynpf.vision.circle import fit_circle
from dynpf.vision.discs import DetectionParams, Disc, detect_discs
from dynpf.vision.projection import PlaneProjection
from dynpf.vision.subsample import subsample, to_full_px

__all__ = [
    "Board",
    "Calibration",
    "CalibrationError",
    "DetectionParams",
    "Disc",
    "PlaneProjection",
    "WorkspaceDisc",
    "calibrate",
    "detect_discs",
    "find_board",
    "fit_circle",
    "subsample",
    "to_full_px",
]
