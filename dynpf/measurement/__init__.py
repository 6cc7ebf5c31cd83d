"""Measurement models: how well each particle explains a reading. All of them satisfy MeasurementModel."""

from dynpf.measurement.model import MeasurementModel
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReading

__all__ = ["MeasurementModel", "RangeBearing", "RangeBearingParams", "RangeBearingReading"]
