"""Particle filters and what they are made of, for robots: NumPy in, NumPy out.

Knows no bus, no file format, no clock and no global random state. The names below are the library's surface; each is
imported when it is first asked for, so that ``import dynpf`` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from dynpf.filters.adaptation import (
        Augmented,
        AugmentedParams,
        Kld,
        KldParams,
        Rescue,
        SensorResetting,
        SensorResettingParams,
    )
    from dynpf.filters.cloud import Cloud
    from dynpf.filters.estimate import PoseEstimate, mean_and_covariance, modes, pose_estimate, quantiles
    from dynpf.filters.extended import ExtendedKalman, ExtendedKalmanParams
    from dynpf.filters.health import Health, HealthParams, Signs, Status, Verdict
    from dynpf.filters.jump import Jump, JumpParams
    from dynpf.filters.kalman import Gaussian
    from dynpf.filters.particle import ParticleFilter, Report
    from dynpf.filters.proposal import Auxiliary, LocalLinearization, Optimal, Prior
    from dynpf.filters.refinement import ScanMatching, ScanMatchingParams
    from dynpf.filters.regularization import GaussianKernel
    from dynpf.filters.relocation import Relocation, RelocationParams
    from dynpf.filters.resampling import Multinomial, Residual, Stratified, Systematic
    from dynpf.filters.search import Search, SearchStart
    from dynpf.filters.smoothing import fixed_lag, rts
    from dynpf.filters.start import FromReadingsStart, KnownStart, UniformStart, start_poses
    from dynpf.filters.unscented import UnscentedKalman, UnscentedKalmanParams
    from dynpf.maps.landmarks import LandmarkMap
    from dynpf.maps.occupancy import OccupancyGrid
    from dynpf.maps.raycast import RayCaster
    from dynpf.maps.segments import SegmentMap
    from dynpf.maps.timeline import MapTimeline
    from dynpf.measurement.beam import BeamModel, BeamParams
    from dynpf.measurement.beam_fit import fit_beam
    from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
    from dynpf.measurement.linear import LinearMeasurement, Observation
    from dynpf.measurement.lines import Lines, PolarLines, PolarLinesParams
    from dynpf.measurement.model import Batched, GaussianMeasurement, MeasurementModel
    from dynpf.measurement.position import GaussianPosition, GaussianPositionParams, Position
    from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
    from dynpf.measurement.range_vector import RangeVector, RangeVectorModel, RangeVectorParams
    from dynpf.measurement.scan import Scan
    from dynpf.measurement.scan_lines import ScanLines, ScanLinesParams
    from dynpf.measurement.split_and_merge import SplitAndMergeParams, extract_lines
    from dynpf.measurement.unknown_landmarks import UnknownLandmarks, UnknownLandmarksParams, UnlabelledReadings
    from dynpf.metrics.bounds import covariance_bound, noiseless_information, posterior_information, rms_bound
    from dynpf.metrics.consistency import coverage, mean_square, nees
    from dynpf.motion.arcs import Arcs, ArcsParams
    from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
    from dynpf.motion.gradient_flow import GradientFlow, GradientFlowParams
    from dynpf.motion.gyro import GyroOdometry, GyroOdometryParams
    from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
    from dynpf.motion.model import Displacement, GaussianMotion, MotionModel, Twist
    from dynpf.motion.odometry import OdometryMotion, OdometryParams
    from dynpf.motion.velocity import Velocity, VelocityParams
    from dynpf.rng import Stream

__all__ = [
    "Arcs",
    "ArcsParams",
    "Augmented",
    "AugmentedParams",
    "Auxiliary",
    "Batched",
    "BeamModel",
    "BeamParams",
    "CapsuleMotion",
    "CapsuleStep",
    "CapsuleStepParams",
    "Cloud",
    "Displacement",
    "ExtendedKalman",
    "ExtendedKalmanParams",
    "FromReadingsStart",
    "Gaussian",
    "GaussianKernel",
    "GaussianMeasurement",
    "GaussianMotion",
    "GaussianPosition",
    "GaussianPositionParams",
    "GradientFlow",
    "GradientFlowParams",
    "GyroOdometry",
    "GyroOdometryParams",
    "Health",
    "HealthParams",
    "Jump",
    "JumpParams",
    "Kld",
    "KldParams",
    "KnownStart",
    "LandmarkMap",
    "LikelihoodField",
    "LikelihoodFieldParams",
    "LinearGaussian",
    "LinearGaussianParams",
    "LinearMeasurement",
    "Lines",
    "LocalLinearization",
    "MapTimeline",
    "MeasurementModel",
    "MotionModel",
    "Multinomial",
    "Observation",
    "OccupancyGrid",
    "OdometryMotion",
    "OdometryParams",
    "Optimal",
    "ParticleFilter",
    "PolarLines",
    "PolarLinesParams",
    "PoseEstimate",
    "Position",
    "Prior",
    "RangeBearing",
    "RangeBearingParams",
    "RangeBearingReadings",
    "RangeVector",
    "RangeVectorModel",
    "RangeVectorParams",
    "RayCaster",
    "Relocation",
    "RelocationParams",
    "Report",
    "Rescue",
    "Residual",
    "Scan",
    "ScanLines",
    "ScanLinesParams",
    "ScanMatching",
    "ScanMatchingParams",
    "Search",
    "SearchStart",
    "SegmentMap",
    "SensorResetting",
    "SensorResettingParams",
    "Signs",
    "SplitAndMergeParams",
    "Status",
    "Stratified",
    "Stream",
    "Systematic",
    "Twist",
    "UniformStart",
    "UnknownLandmarks",
    "UnknownLandmarksParams",
    "UnlabelledReadings",
    "UnscentedKalman",
    "UnscentedKalmanParams",
    "Velocity",
    "VelocityParams",
    "Verdict",
    "covariance_bound",
    "coverage",
    "extract_lines",
    "fit_beam",
    "fixed_lag",
    "mean_and_covariance",
    "mean_square",
    "modes",
    "nees",
    "noiseless_information",
    "pose_estimate",
    "posterior_information",
    "quantiles",
    "rms_bound",
    "rts",
    "start_poses",
]

_MODULES: dict[str, tuple[str, ...]] = {
    "dynpf.filters.adaptation": (
        "Augmented",
        "AugmentedParams",
        "Kld",
        "KldParams",
        "Rescue",
        "SensorResetting",
        "SensorResettingParams",
    ),
    "dynpf.filters.cloud": ("Cloud",),
    "dynpf.filters.estimate": ("PoseEstimate", "mean_and_covariance", "modes", "pose_estimate", "quantiles"),
    "dynpf.filters.extended": ("ExtendedKalman", "ExtendedKalmanParams"),
    "dynpf.filters.health": ("Health", "HealthParams", "Signs", "Status", "Verdict"),
    "dynpf.filters.jump": ("Jump", "JumpParams"),
    "dynpf.filters.kalman": ("Gaussian",),
    "dynpf.filters.particle": ("ParticleFilter", "Report"),
    "dynpf.filters.proposal": ("Auxiliary", "LocalLinearization", "Optimal", "Prior"),
    "dynpf.filters.refinement": ("ScanMatching", "ScanMatchingParams"),
    "dynpf.filters.regularization": ("GaussianKernel",),
    "dynpf.filters.relocation": ("Relocation", "RelocationParams"),
    "dynpf.filters.resampling": ("Multinomial", "Residual", "Stratified", "Systematic"),
    "dynpf.filters.search": ("Search", "SearchStart"),
    "dynpf.filters.smoothing": ("fixed_lag", "rts"),
    "dynpf.filters.start": ("FromReadingsStart", "KnownStart", "UniformStart", "start_poses"),
    "dynpf.filters.unscented": ("UnscentedKalman", "UnscentedKalmanParams"),
    "dynpf.maps.landmarks": ("LandmarkMap",),
    "dynpf.maps.occupancy": ("OccupancyGrid",),
    "dynpf.maps.raycast": ("RayCaster",),
    "dynpf.maps.segments": ("SegmentMap",),
    "dynpf.maps.timeline": ("MapTimeline",),
    "dynpf.measurement.beam": ("BeamModel", "BeamParams"),
    "dynpf.measurement.beam_fit": ("fit_beam",),
    "dynpf.measurement.likelihood_field": ("LikelihoodField", "LikelihoodFieldParams"),
    "dynpf.measurement.linear": ("LinearMeasurement", "Observation"),
    "dynpf.measurement.lines": ("Lines", "PolarLines", "PolarLinesParams"),
    "dynpf.measurement.model": ("Batched", "GaussianMeasurement", "MeasurementModel"),
    "dynpf.measurement.position": ("GaussianPosition", "GaussianPositionParams", "Position"),
    "dynpf.measurement.range_bearing": ("RangeBearing", "RangeBearingParams", "RangeBearingReadings"),
    "dynpf.measurement.range_vector": ("RangeVector", "RangeVectorModel", "RangeVectorParams"),
    "dynpf.measurement.scan": ("Scan",),
    "dynpf.measurement.scan_lines": ("ScanLines", "ScanLinesParams"),
    "dynpf.measurement.split_and_merge": ("SplitAndMergeParams", "extract_lines"),
    "dynpf.measurement.unknown_landmarks": ("UnknownLandmarks", "UnknownLandmarksParams", "UnlabelledReadings"),
    "dynpf.metrics.bounds": ("covariance_bound", "noiseless_information", "posterior_information", "rms_bound"),
    "dynpf.metrics.consistency": ("coverage", "mean_square", "nees"),
    "dynpf.motion.arcs": ("Arcs", "ArcsParams"),
    "dynpf.motion.capsule": ("CapsuleMotion", "CapsuleStep", "CapsuleStepParams"),
    "dynpf.motion.gradient_flow": ("GradientFlow", "GradientFlowParams"),
    "dynpf.motion.gyro": ("GyroOdometry", "GyroOdometryParams"),
    "dynpf.motion.linear": ("LinearGaussian", "LinearGaussianParams"),
    "dynpf.motion.model": ("Displacement", "GaussianMotion", "MotionModel", "Twist"),
    "dynpf.motion.odometry": ("OdometryMotion", "OdometryParams"),
    "dynpf.motion.velocity": ("Velocity", "VelocityParams"),
    "dynpf.rng": ("Stream",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # a type checker takes a module with this function to have any name that is asked for

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'dynpf' has no attribute {name!r}")
        return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
