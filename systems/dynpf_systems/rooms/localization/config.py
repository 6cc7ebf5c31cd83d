"""What a scenario says about the estimator, in the table ``[estimator]``; ``kind`` chooses which one runs; SI units."""

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import msgspec
from dynpf_services.scenario.user_component import UserComponent
from msgspec import Meta

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
from dynpf.measurement.range_bearing import RangeBearingParams
from dynpf.motion.arcs import ArcsParams
from dynpf.motion.calibration import CalibrationParams
from dynpf.motion.capsule import CapsuleStepParams
from dynpf.motion.gradient_flow import GradientFlowParams
from dynpf.motion.linear import LinearGaussianParams
from dynpf.motion.odometry import OdometryParams
from dynpf.motion.velocity import VelocityParams
from dynpf_systems.rooms.localization.readings import MODELS

__all__ = [
    "LocalizationConfig",
    "SirParams",
]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Ticks = Annotated[int, Meta(ge=1)]


class SirParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="sir"):
    """The particle filter: importance sampling and resampling, with the proposal and the rest given beside it."""

    threads: Annotated[int, Meta(ge=1, le=64)] = 1  # that share the work on many particles; the results are the same


class GradientFlowTable(GradientFlowParams, frozen=True, kw_only=True, tag="gradient_flow"):
    """A robot that descends a potential to its goal (PARTS); of its odometry, only the times count."""

    field: DescentFlowParams


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
if TYPE_CHECKING:
    MeasurementTable: TypeAlias = Any
else:
    MeasurementTable = reduce(or_, [*MODELS, UserComponent])  # whatever models the sensors list
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
    scan_range_min: NonNegative | None = None  # m; a range below it tells nothing; absent: what the scanner says
    scan_range_max: Positive | None = None  # m, which a beam without return reads; absent: what the scanner says
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
