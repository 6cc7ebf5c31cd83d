"""Motion models: how particles move under a twist. One model a module; all of them satisfy MotionModel."""

from dynpf.motion.arcs import Arcs, ArcsParams
from dynpf.motion.calibration import CalibratedArcs, CalibrationParams
from dynpf.motion.model import MotionModel, Twist

__all__ = ["Arcs", "ArcsParams", "CalibratedArcs", "CalibrationParams", "MotionModel", "Twist"]
