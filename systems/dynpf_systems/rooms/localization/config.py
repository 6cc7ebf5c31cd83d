"""Configuration of the estimator, the table ``[estimator]`` of a scenario; ``kind`` chooses the estimator; SI units."""

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
from dynpf.filters.refinement import ScanMatchingParams
from dynpf.filters.regularization import GaussianKernel
from dynpf.filters.relocation import RelocationParams
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
from dynpf.types import NonNegative, Positive
from dynpf_systems.rooms.localization.readings import MODELS

__all__ = [
    "LocalizationConfig",
    "SirParams",
    "StepParams",
]


class SirParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="sir"):
    """The particle filter: sequential importance sampling with resampling; its components stand beside it."""

    threads: Annotated[int, Meta(ge=1, le=64)] = 1  # of the kernels; results do not depend on it


class GradientFlowTable(GradientFlowParams, frozen=True, kw_only=True, tag="gradient_flow"):
    """Motion down the gradient of a potential to a goal (PARTS); of odometry, only the durations are used."""

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
AdaptationTable = KldParams | AugmentedParams | SensorResettingParams | JumpParams | RelocationParams | UserComponent


class StepParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How far the robot gets, in net, before its motion is given to the filter as one step, with the noise of one."""

    travel: Positive = 0.1  # m
    turn: Positive = 0.1  # rad


class LocalizationConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="localization"
):
    """A filter over the pose of a robot in a known map, composed of components."""

    filter: FilterTable = SirParams()
    n: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000  # particles
    start: KnownStart | UniformStart | FromReadingsStart | SearchStart = KnownStart()
    # Seconds between an odometry message and the motion that it describes.
    odometry_delay: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    # Distance and turn since the last update; the next update needs either of them. Errors of readings from the same
    # pose are correlated, so repeated updates there would make the filter overconfident.
    min_travel: NonNegative = 0.0  # m
    min_turn: NonNegative = 0.0  # rad
    # Motion by odometry is put together to steps of so much; absent: each record is a step by itself, and its jitter
    # adds to the noise. With steps, min_travel and min_turn are of the net displacement, too.
    odometry_step: StepParams | None = None
    scan_range_min: NonNegative | None = None  # m; shorter ranges are ignored; absent: the scanner's own
    scan_range_max: Positive | None = None  # m, the reading of a beam without return; absent: the scanner's own
    motion: MotionTable = ArcsParams()
    calibration: CalibrationParams | None = None  # for arcs; absent: odometry is not calibrated
    measurement: Annotated[tuple[MeasurementTable, ...], Meta(min_length=1, max_length=16)] = (RangeBearingParams(),)
    resampling: ResamplingTable = Systematic()
    proposal: ProposalTable = Prior()
    regularization: RegularizationTable | None = None  # absent: resampled particles are exact copies
    refinement: ScanMatchingParams | None = None  # of the belief at each update; absent: none
    # At most one rule for the number of particles, and one for drawing new particles when the filter is lost.
    adaptation: Annotated[tuple[AdaptationTable, ...], Meta(max_length=2)] = ()
    # Where new particles are drawn; absent: anywhere, or for a jump where a search finds poses.
    restart: UniformStart | FromReadingsStart | SearchStart | None = None
    health: HealthParams = HealthParams()  # thresholds of the health status
