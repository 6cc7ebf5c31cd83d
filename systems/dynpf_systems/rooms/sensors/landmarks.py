"""Range and bearing to identified landmarks: simulated, from logs, and as filters take them."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import LandmarkReading, LandmarkReadings, Message, RobotState
from dynpf_services.scenario.context import Context
from dynpf_services.sensors.kind import Check, ModelKind, Read, ReadingKind, SensorKind, SensorTable, Simulated
from msgspec import UNSET

from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.measurement.unknown_landmarks import UnknownLandmarks, UnknownLandmarksParams, UnlabelledReadings
from dynpf.portable import atan2, hypot
from dynpf.rng import Draws
from dynpf.types import Float32s, FloatArray, Floats, NonNegative, Positive, Share
from dynpf_systems.rooms.sensors.view import FieldOfView

__all__ = ["LANDMARKS", "LandmarkSensor"]


class LandmarkSensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Range and bearing to identified landmarks; range noise sqrt(range_std^2 + (range_std_per_metre * range)^2)."""

    max_range: Positive = 5.0  # m
    field_of_view: FieldOfView = math.tau  # rad, centred on the heading
    range_std: NonNegative = 0.02  # m
    range_std_per_metre: NonNegative = 0.0
    bearing_std: NonNegative = 0.01  # rad
    misread_probability: Share = 0.0  # a reading carries another landmark's number


def _made(sensor: LandmarkSensor, context: Context) -> Read:
    landmarks = tuple(context.fact("landmarks") or ())
    if not landmarks:
        raise ScenarioError("sensors.landmarks needs landmarks; this run has none")
    return lambda truth, draws: _read(sensor, truth.robot, landmarks, draws)


def _read(sensor: LandmarkSensor, robot: RobotState, landmarks: tuple[Landmark, ...], draws: Draws) -> LandmarkReadings:
    """Return the readings; each landmark has its own draws, so one that comes into view changes no other reading."""
    noise = draws.standard_normal((len(landmarks), 2)).tolist()
    misread = (draws.random(len(landmarks)) < sensor.misread_probability).tolist()
    swap = draws.integers(1, max(len(landmarks), 2), size=len(landmarks)).tolist()
    readings = []
    for index, landmark in enumerate(landmarks):
        distance = hypot(landmark.x - robot.x, landmark.y - robot.y)
        bearing = math.remainder(atan2(landmark.y - robot.y, landmark.x - robot.x) - robot.theta, math.tau)
        if distance > sensor.max_range or abs(bearing) > sensor.field_of_view / 2:
            continue
        std = hypot(sensor.range_std, sensor.range_std_per_metre * distance)
        seen_as = landmarks[(index + swap[index]) % len(landmarks)] if misread[index] else landmark
        readings.append(
            LandmarkReading(
                landmark=seen_as.id,
                range=max(0.0, distance + std * noise[index][0]),
                bearing=math.remainder(bearing + sensor.bearing_std * noise[index][1], math.tau),
            )
        )
    return LandmarkReadings(readings=tuple(readings))


def _checked(context: Context) -> Check:
    """Return the check of records: a reading of a landmark not on the map, often misread, must carry its position."""
    known = frozenset(landmark.id for landmark in context.fact("landmarks") or ())

    def fault(reading: LandmarkReading) -> str:
        """Return why a reading is left out, or an empty string."""
        if reading.landmark not in known and reading.x is UNSET:
            return "not on the map"
        good = math.isfinite(reading.range) and math.isfinite(reading.bearing) and reading.range >= 0.0
        return "" if good else "refused"

    def check(message: LandmarkReadings) -> tuple[Message | None, Iterable[str]]:
        """Return the message with its valid readings, None without any, and the reasons for the others."""
        faults = [fault(reading) for reading in message.readings]
        kept = tuple(
            msgspec.structs.replace(reading, bearing=math.remainder(reading.bearing, math.tau))
            for reading, reason in zip(message.readings, faults, strict=True)
            if not reason
        )
        return LandmarkReadings(readings=kept) if kept else None, filter(None, faults)

    return check


def _labelled(message: LandmarkReadings, _: None) -> RangeBearingReadings:
    ids = np.array([reading.landmark for reading in message.readings], dtype=np.int64)
    return RangeBearingReadings(ids, *_polar(message.readings), _positions(message.readings))


def _unlabelled(message: LandmarkReadings, _: None) -> UnlabelledReadings:
    return UnlabelledReadings(*_polar(message.readings))


def _polar(readings: Sequence[LandmarkReading]) -> tuple[Float32s, Float32s]:
    ranges = np.array([reading.range for reading in readings], dtype=np.float32)
    return ranges, np.array([reading.bearing for reading in readings], dtype=np.float32)


def _positions(readings: Sequence[LandmarkReading]) -> FloatArray | None:
    """Return the positions of moving landmarks, shape (2, K), NaN for fixed ones; None where no landmark moves."""
    if all(reading.x is UNSET or reading.y is UNSET for reading in readings):
        return None
    positions = (
        (reading.x, reading.y) if UNSET not in (reading.x, reading.y) else (np.nan, np.nan) for reading in readings
    )
    return np.array(list(positions), dtype=np.float64).T


def _example(maps: Any, pose: Floats, _model: Any) -> LandmarkReadings | None:
    if maps.landmarks is None:
        return None
    x, y, theta = pose.tolist()
    seen = [(number, *(maps.landmarks.position(number) - [x, y])) for number in maps.landmarks.ids[:2]]
    return LandmarkReadings(
        readings=tuple(
            LandmarkReading(
                landmark=number,
                range=hypot(float(dx), float(dy)),
                bearing=math.remainder(atan2(float(dy), float(dx)) - theta, math.tau),
            )
            for number, dx, dy in seen
        )
    )


def _size(readings: RangeBearingReadings | UnlabelledReadings) -> int:
    return len(readings.ranges)


LANDMARKS = SensorKind(
    name="landmarks",
    message=LandmarkReadings,
    simulated=Simulated(LandmarkSensor, _made),
    checked=_checked,
    readings=(
        ReadingKind(RangeBearingReadings, _labelled, _example, _size),
        ReadingKind(UnlabelledReadings, _unlabelled, _example, _size),
    ),
    models=(
        ModelKind(RangeBearingParams, RangeBearingReadings, RangeBearing, "landmarks", calibrated=True),
        ModelKind(UnknownLandmarksParams, UnlabelledReadings, UnknownLandmarks, "landmarks"),
    ),
)
