"""What a scenario says about the estimator, in the table ``[estimator]``; ``kind`` chooses which one runs."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.filters.sir import SystematicParams
from dynpf.filters.start import KnownStart
from dynpf.measurement.range_bearing import RangeBearingParams
from dynpf.motion.arcs import ArcsParams
from dynpf.motion.calibration import CalibrationParams

__all__ = ["LocalizationConfig"]


class LocalizationConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="localization"
):
    """A particle filter over the pose of a robot among known landmarks."""

    filter: Literal["sir"] = "sir"
    n: Annotated[int, Meta(ge=1, le=1_000_000)] = 1000
    start: KnownStart = KnownStart()
    # Seconds between an odometry message and the robot moving as it says.
    odometry_delay: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    motion: ArcsParams = ArcsParams()
    calibration: CalibrationParams | None = None  # absent: odometry is taken as it comes
    measurement: Annotated[tuple[RangeBearingParams, ...], Meta(min_length=1, max_length=1)] = (RangeBearingParams(),)
    resampling: SystematicParams = SystematicParams()
