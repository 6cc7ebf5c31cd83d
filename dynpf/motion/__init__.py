"""Motion models: how particles move under a control. One model a module; all of them satisfy GaussianMotion."""

from dynpf.motion.arcs import Arcs, ArcsParams
from dynpf.motion.calibration import CalibratedArcs, CalibrationParams
from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.motion.gradient_flow import GradientFlow, GradientFlowParams
from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
from dynpf.motion.model import Displacement, GaussianMotion, MotionModel, Twist
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.motion.velocity import Velocity, VelocityParams

__all__ = [
    "Arcs",
    "ArcsParams",
    "CalibratedArcs",
    "CalibrationParams",
    "CapsuleMotion",
    "CapsuleStep",
    "CapsuleStepParams",
    "Displacement",
    "GaussianMotion",
    "GradientFlow",
    "GradientFlowParams",
    "LinearGaussian",
    "LinearGaussianParams",
    "MotionModel",
    "OdometryMotion",
    "OdometryParams",
    "Twist",
    "Velocity",
    "VelocityParams",
]
