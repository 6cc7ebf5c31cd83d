"""Readings that a rehearsal takes in: what a robot at a given pose would be told, so that it is believed."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import (
    LandmarkReading,
    LandmarkReadings,
    LaserScan,
    LineReading,
    LineReadings,
    Message,
    PositionFix,
    planar_pose,
    timestamp,
)
from dynpf_services.scenario.user_component import UserComponent

from dynpf.maps.segments import polar_in_frame
from dynpf.measurement.lines import Lines
from dynpf.measurement.model import MeasurementModel
from dynpf.measurement.position import Position
from dynpf.measurement.range_bearing import RangeBearingReadings
from dynpf.measurement.range_vector import RangeVector, RangeVectorModel
from dynpf.measurement.scan import Scan
from dynpf.measurement.unknown_landmarks import UnlabelledReadings
from dynpf.portable import atan2, hypot
from dynpf.se2 import Floats
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.readings import reading_of
from dynpf_systems.rooms.maps import Maps

__all__ = ["example_readings"]

BEAMS = 5


def example_readings(
    config: LocalizationConfig,
    models: dict[type, MeasurementModel[Any]],
    maps: Maps,
    pose: Floats,
    *,
    range_min: float,
    range_max: float,
) -> Iterator[Any]:
    """Yield a reading for each measurement model, as it would be at ``pose`` (3,).

    A model with a method ``example()`` gives one itself; a user's model without is left out.
    """
    for table, (kind, model) in zip(config.measurement, models.items(), strict=True):
        if hasattr(model, "example"):
            yield model.example()
            continue
        if isinstance(table, UserComponent):
            continue
        beams = len(model.params.angles) if isinstance(model, RangeVectorModel) else BEAMS
        message = _message(kind, maps, pose, beams, range_max)
        if message is not None:
            yield reading_of(message, kind, range_min=range_min, range_max=range_max)


def _message(kind: type, maps: Maps, pose: Floats, beams: int, range_max: float) -> Message | None:
    x, y, theta = pose.tolist()
    if kind in {RangeBearingReadings, UnlabelledReadings} and maps.landmarks is not None:
        seen = [(one, *(maps.landmarks.position(one) - [x, y])) for one in maps.landmarks.ids[:2]]
        return LandmarkReadings(
            readings=tuple(
                LandmarkReading(
                    landmark=one,
                    range=hypot(float(dx), float(dy)),
                    bearing=math.remainder(atan2(float(dy), float(dx)) - theta, math.tau),
                )
                for one, dx, dy in seen
            )
        )
    if kind in {Scan, RangeVector}:
        length = 0.5 * min(range_max, 2.0)
        return LaserScan(
            timestamp=timestamp(0),
            frame_id=frames.ROBOT,
            pose=planar_pose(0.0, 0.0, 0.0),
            start_angle=-1.0,
            end_angle=1.0,
            ranges=(length,) * beams,
        )
    if kind is Lines and maps.segments is not None:
        rho, alpha = (
            float(one[0]) for one in polar_in_frame(maps.segments.rho, maps.segments.alpha, pose.astype(np.float64))
        )
        return LineReadings(readings=(LineReading(rho=rho, alpha=alpha, length=0.0),))
    if kind is Position:
        return PositionFix(x=x, y=y)
    return None
