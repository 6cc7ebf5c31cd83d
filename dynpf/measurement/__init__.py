"""Measurement models: what a sensor at a pose would read, and how likely a reading is (``MeasurementModel``)."""

from dynpf.measurement.linear import LinearMeasurement, Observation
from dynpf.measurement.lines import Lines, PolarLines, PolarLinesParams
from dynpf.measurement.model import GaussianMeasurement, MeasurementModel
from dynpf.measurement.position import GaussianPosition, GaussianPositionParams, Position
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.measurement.range_vector import RangeVector, RangeVectorModel, RangeVectorParams
from dynpf.measurement.scan import Scan
from dynpf.measurement.scan_lines import ScanLines, ScanLinesParams
from dynpf.measurement.split_and_merge import SplitAndMergeParams, extract_lines
from dynpf.measurement.unknown_landmarks import UnknownLandmarks, UnknownLandmarksParams, UnlabelledReadings

__all__ = [
    "GaussianMeasurement",
    "GaussianPosition",
    "GaussianPositionParams",
    "LinearMeasurement",
    "Lines",
    "MeasurementModel",
    "Observation",
    "PolarLines",
    "PolarLinesParams",
    "Position",
    "RangeBearing",
    "RangeBearingParams",
    "RangeBearingReadings",
    "RangeVector",
    "RangeVectorModel",
    "RangeVectorParams",
    "Scan",
    "ScanLines",
    "ScanLinesParams",
    "SplitAndMergeParams",
    "UnknownLandmarks",
    "UnknownLandmarksParams",
    "UnlabelledReadings",
    "extract_lines",
]
