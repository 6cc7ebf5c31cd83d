"""From the messages of the sensors to the readings that the measurement models take."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from dynpf_protocol.messages import (
    LandmarkReading,
    LandmarkReadings,
    LaserScan,
    LineReadings,
    Message,
    PositionFix,
    heading,
)
from dynpf_services.scenario.user_component import UserComponent
from msgspec import UNSET

from dynpf.measurement.beam import BeamParams
from dynpf.measurement.likelihood_field import LikelihoodFieldParams
from dynpf.measurement.lines import Lines, PolarLinesParams
from dynpf.measurement.position import GaussianPositionParams, Position
from dynpf.measurement.range_bearing import RangeBearingParams, RangeBearingReadings
from dynpf.measurement.range_vector import RangeVector, RangeVectorParams
from dynpf.measurement.scan import Scan
from dynpf.measurement.scan_lines import ScanLinesParams
from dynpf.measurement.unknown_landmarks import UnknownLandmarksParams, UnlabelledReadings
from dynpf.se2 import FloatArray

__all__ = ["READINGS", "TOPICS", "is_message", "reading_of", "reading_topics", "size_of"]

TOPICS: Mapping[type, str] = {
    RangeBearingReadings: "sensors/landmarks",
    UnlabelledReadings: "sensors/landmarks",
    Scan: "sensors/scan",
    RangeVector: "sensors/scan",
    Lines: "sensors/lines",
    Position: "sensors/position",
}
"""The types of readings, and the topic that each is made from."""


READINGS: Mapping[type, type] = {
    RangeBearingParams: RangeBearingReadings,
    UnknownLandmarksParams: UnlabelledReadings,
    LikelihoodFieldParams: Scan,
    BeamParams: Scan,
    RangeVectorParams: RangeVector,
    PolarLinesParams: Lines,
    ScanLinesParams: Scan,
    GaussianPositionParams: Position,
}
"""The tables of measurement models, and the type of reading that each model takes."""


def is_message(kind: object) -> bool:
    """Return whether a type of readings is one of messages: of a user's own sensor, taken as it comes."""
    return isinstance(kind, type) and issubclass(kind, Message)


def reading_topics(tables: Iterable[Any], user_class: Callable[[str], type | None]) -> set[str | type[Message]]:
    """Return the topics of the readings that measurement models take, by their tables; messages of one's own by type.

    ``user_class`` gives a class of the user's by its name, None for one that must not be imported: what that takes
    nobody knows.
    """
    readings = (
        getattr(user_class(table.name), "reading", None) if isinstance(table, UserComponent) else READINGS[type(table)]
        for table in tables
    )
    return {
        TOPICS.get(reading, reading)
        for reading in readings
        if isinstance(reading, type) and (reading in TOPICS or is_message(reading))
    }


def reading_of(message: Message, kind: type, *, range_min: float = 0.0, range_max: float = 0.0) -> Any:
    """Return the message as a reading of the given type, one of those made from its topic.

    ``range_min`` and ``range_max``, metres, are what the scanner measures between. A beam without return, which reads
    ``range_max``, is +inf in a RangeVector.
    """
    match message:
        case _ if type(message) is kind:
            return message
        case LandmarkReadings(readings=readings):
            ranges = np.array([one.range for one in readings], dtype=np.float32)
            bearings = np.array([one.bearing for one in readings], dtype=np.float32)
            if kind is UnlabelledReadings:
                return UnlabelledReadings(ranges, bearings)
            ids = np.array([one.landmark for one in readings], dtype=np.int64)
            return RangeBearingReadings(ids, ranges, bearings, _places(readings))
        case LaserScan():
            ranges = np.array(message.ranges, dtype=np.float32)
            if kind is RangeVector:
                return RangeVector(np.where(ranges < range_max, ranges, np.float32(np.inf)))
            angles = np.linspace(message.start_angle, message.end_angle, len(ranges), dtype=np.float32)
            place = message.pose.position
            return Scan(angles, ranges, range_min, range_max, (place.x, place.y, heading(message.pose.orientation)))
        case LineReadings(readings=readings):
            columns = ([getattr(one, name) for one in readings] for name in ("rho", "alpha", "length"))
            return Lines(*(np.array(column, dtype=np.float32) for column in columns))
        case PositionFix():
            return Position(message.x, message.y)
    raise TypeError(f"{type(message).__name__} is no reading")


def _places(readings: Sequence[LandmarkReading]) -> FloatArray | None:
    """Return where landmarks that move were, shape (2, K), NaN for others; None where none moves."""
    if all(one.x is UNSET or one.y is UNSET for one in readings):
        return None
    places = ((one.x, one.y) if UNSET not in (one.x, one.y) else (np.nan, np.nan) for one in readings)
    return np.array(list(places), dtype=np.float64).T


def size_of(reading: Any) -> int:
    """Return how many readings there are in one: of landmarks or lines, so many; a scan is taken as a whole."""
    match reading:
        case RangeBearingReadings() | UnlabelledReadings():
            return len(reading.ranges)
        case Lines():
            return len(reading.rho)
    return 1
