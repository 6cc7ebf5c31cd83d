"""What a scenario says about the estimator, in the table ``[estimator]``; ``kind`` chooses which one runs; SI units."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.colon.end_radius import EndRadiusParams
from dynpf.colon.hypotheses import HypothesesParams
from dynpf.fields.flow import DescentFlowParams
from dynpf.filters.adaptation import AugmentedParams, KldParams, SensorResettingParams
from dynpf.filters.extended import ExtendedKalmanParams
from dynpf.filters.health import HealthParams
from dynpf.filters.jump import JumpParams
from dynpf.filters.proposal import Auxiliary, LocalLinearization, Optimal, Prior
from dynpf.filters.regularization import GaussianKernel
from dynpf.filters.resampling import Multinomial, Residual, Stratified, Systematic
from dynpf.filters.search import SearchStart
from dynpf.filters.start import FromReadingsStart, KnownStart, UniformStart
from dynpf.filters.unscented import UnscentedKalmanParams
from dynpf.measurement.beam import BeamParams
from dynpf.measurement.likelihood_field import LikelihoodFieldParams
from dynpf.measurement.lines import PolarLinesParams
from dynpf.measurement.position import GaussianPositionParams
from dynpf.measurement.range_bearing import RangeBearingParams
from dynpf.measurement.range_vector import RangeVectorParams
from dynpf.measurement.scan_lines import ScanLinesParams
from dynpf.measurement.unknown_landmarks import UnknownLandmarksParams
from dynpf.motion.arcs import ArcsParams
from dynpf.motion.calibration import CalibrationParams
from dynpf.motion.capsule import CapsuleStepParams
from dynpf.motion.gradient_flow import GradientFlowParams
from dynpf.motion.linear import LinearGaussianParams
from dynpf.motion.odometry import OdometryParams
from dynpf.motion.velocity import VelocityParams
from dynpf_services.scenario.user_code import UserComponent
from dynpf_services.task import NOISE, Noise, RearrangementTask

__all__ = [
    "CapsuleEstimatorConfig",
    "ClassicFilter",
    "EndRadiusFilter",
    "FilterName",
    "HypothesesFilter",
    "LocalizationConfig",
    "RearrangementConfig",
    "SirParams",
]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Ticks = Annotated[int, Meta(ge=1)]


_STEADY, _SHARP = 1e-8, 2.5e-7  # m^2: noise that is left of a motion and of a detection without noise


class SirParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="sir"):
    """The particle filter: importance sampling and resampling, with the proposal and the rest given beside it."""

    threads: Annotated[int, Meta(ge=1, le=64)] = 1  # that share the work on many particles; the results are the same


class GradientFlowTable(GradientFlowParams, frozen=True, kw_only=True, tag="gradient_flow"):
    """A robot that descends a potential to its goal (PARTS); of its odometry, only the times count."""

    field: DescentFlowParams


FilterName = Literal["optimal", "prior", "auxiliary", "local_linearization", "extended_kalman", "unscented_kalman"]

FilterTable = SirParams | ExtendedKalmanParams | UnscentedKalmanParams | UserComponent
MotionTable = (
    ArcsParams
    | VelocityParams
    | OdometryParams
    | CapsuleStepParams
    | LinearGaussianParams
    | GradientFlowTable
    | UserComponent
)
MeasurementTable = (
    RangeBearingParams
    | UnknownLandmarksParams
    | LikelihoodFieldParams
    | BeamParams
    | RangeVectorParams
    | PolarLinesParams
    | ScanLinesParams
    | GaussianPositionParams
    | UserComponent
)
ResamplingTable = Systematic | Stratified | Residual | Multinomial | UserComponent
ProposalTable = Prior | Optimal | LocalLinearization | Auxiliary | UserComponent
RegularizationTable = GaussianKernel | UserComponent
AdaptationTable = KldParams | AugmentedParams | SensorResettingParams | JumpParams | UserComponent


class LocalizationConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="localization"
):
    """A filter over the pose of a robot in a known map, put together from components."""

    filter: FilterTable = SirParams()
    n: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000  # particles
    start: KnownStart | UniformStart | FromReadingsStart | SearchStart = KnownStart()
    # Seconds between an odometry message and the robot moving as it says.
    odometry_delay: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    # Way and turn since the last readings were taken in, of which one must be reached before others are. What is seen
    # twice from one place errs alike, so it would be believed too much.
    min_travel: NonNegative = 0.0  # m
    min_turn: NonNegative = 0.0  # rad
    scan_range_min: NonNegative = 0.0  # m; a range below it tells nothing
    scan_range_max: Positive | None = None  # m, which a beam without return reads; absent: the simulated scanner's
    motion: MotionTable = ArcsParams()
    calibration: CalibrationParams | None = None  # for arcs; absent: odometry is taken as it comes
    measurement: Annotated[tuple[MeasurementTable, ...], Meta(min_length=1, max_length=16)] = (RangeBearingParams(),)
    resampling: ResamplingTable = Systematic()
    proposal: ProposalTable = Prior()
    regularization: RegularizationTable | None = None  # absent: survivors are copies of one another
    # How many particles there are (one of these), and when some are drawn anew because the filter is lost (another).
    adaptation: Annotated[tuple[AdaptationTable, ...], Meta(max_length=2)] = ()
    # Where those begin that are drawn anew; absent: anywhere, or for a jump where a search finds them.
    restart: UniformStart | FromReadingsStart | SearchStart | None = None
    health: HealthParams = HealthParams()  # when the estimate counts as uncertain, or as lost


class RearrangementConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="rearrangement"
):
    """A filter for the robot, Kalman filters for the parts, and how detections are matched to them."""

    filter: FilterName = "optimal"  # the robot's: a particle filter with this proposal, or a Kalman filter
    n: Annotated[int, Meta(ge=1, le=1_000_000)] = 100  # particles, of a filter that has some
    # m^2, of the robot's motion, a tick and coordinate; absent: that of the task's noise, but at least (0.1 mm)^2.
    process_variance: NonNegative | None = None
    # m^2, of a detected centre, each coordinate; absent: that of the task's noise and (0.5 mm)^2 of the detection.
    measurement_variance: Positive | None = None
    part_process_variance: NonNegative = 1e-7  # of a part that nobody holds, a tick and coordinate
    encoder_variance: NonNegative = 1e-6  # rad^2, of the gripper's angle
    resampling_threshold: Annotated[float, Meta(ge=0.0, le=1.0)] = 2.0 / 3.0  # N_eff below this share of n resamples
    gate: Positive = 20.0  # squared Mahalanobis distance beyond which a detection is another object's
    radius_sigma: Positive = 0.002
    radius_gate: Positive = 0.006  # metres
    robot_grey: float | None = None  # expected grey, less the background's; without it greys are learnt ...
    part_grey: float | None = None  # ... and at first only the radius tells which disc is which
    grey_sigma: Positive = 20.0
    prior_variance: Positive = 1.0  # of a position that nothing is known about
    lost_after: Ticks = 20  # detections in which an object is missing, then its position is forgotten
    particle_period_s: NonNegative = 0.2  # logical time between particle clouds

    def noise(self, task: RearrangementTask) -> Noise:
        """Return what noise the filters expect."""
        process, measurement = NOISE[task.noise]
        return Noise(
            max(process, _STEADY) if self.process_variance is None else self.process_variance,
            measurement + _SHARP if self.measurement_variance is None else self.measurement_variance,
        )


class ClassicFilter(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="classic"
):
    """COLON's own filter, in the map that it is told of: 100 px, 0.1 px and 0.1 rad, resampling at each step."""

    n: Annotated[int, Meta(ge=1)] = 100  # particles


class HypothesesFilter(HypothesesParams, frozen=True, kw_only=True, tag="hypotheses"):
    """The map is part of what is estimated: one of those listed, or none of these. Lengths are in px."""

    # Those listed; the first holds at the start.
    maps: Annotated[tuple[str, ...], Meta(min_length=1, max_length=63)] = ("a", "b")
    # What the filter makes of colon.told; obeyed: no map is estimated.
    schedule: Literal["ignored", "hint", "obeyed"] = "ignored"


class EndRadiusFilter(EndRadiusParams, frozen=True, kw_only=True, tag="end_radius"):
    """The map is a member of the family of tubes with a round end, of a radius that is estimated. Lengths are in px."""

    # Of the members that are drawn; between two, ranges go from one to the other.
    radii_px: Annotated[tuple[Positive, ...], Meta(min_length=2)] = tuple(float(radius) for radius in range(90, 166, 5))


class CapsuleEstimatorConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """A filter over the pose of a capsule in the tube of the table ``[colon]``, whose walls may change."""

    filter: ClassicFilter | HypothesesFilter | EndRadiusFilter = HypothesesFilter()
    start: Literal["known", "anywhere"] = "known"  # anywhere: the pose is searched for in the first map
