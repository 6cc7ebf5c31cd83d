"""Measurement models: what a sensor at a pose would read, and how likely a reading is (``MeasurementModel``)."""

from dynpf.measurement.model import MeasurementModel
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReading

__all__ = ["MeasurementModel", "RangeBearing", "RangeBearingParams", "RangeBearingReading"]
