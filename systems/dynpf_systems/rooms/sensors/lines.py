"""Line segments of walls, as line extraction finds them: simulated, and as filters take them."""

import math
from typing import Annotated, Any

import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import LineReading, LineReadings, RobotState
from dynpf_services.scenario.context import Context
from dynpf_services.sensors.kind import ModelKind, Read, ReadingKind, SensorKind, SensorTable, Simulated
from msgspec import Meta

from dynpf.maps.segments import polar_in_frame
from dynpf.measurement.lines import Lines, PolarLines, PolarLinesParams
from dynpf.measurement.ray import ray_segments
from dynpf.portable import atan2, hypot, sincos
from dynpf.rng import Draws
from dynpf.types import FloatArray, Floats, NonNegative, Positive
from dynpf_systems.rooms.maps import maps_of
from dynpf_systems.rooms.sensors.view import FieldOfView

__all__ = ["LINES", "LineSensor"]


class LineSensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Line extraction from the walls in view: the visible parts of the map's segments.

    Beams find them, as in a scan; a part that fewer than ``min_beams`` beams meet is not found.
    """

    beams: Annotated[int, Meta(ge=2, le=100_000)] = 181
    min_beams: Annotated[int, Meta(ge=2)] = 5
    field_of_view: FieldOfView = math.pi  # rad, first to last beam, centred on the heading
    max_range: Positive = 4.0  # m
    min_length: NonNegative = 0.2  # m; a shorter part is not found
    rho_std: NonNegative = 0.02  # m, of the line's distance
    alpha_std: NonNegative = 0.01  # rad, of its direction


def _made(sensor: LineSensor, context: Context) -> Read:
    segments = maps_of(context).segments
    if segments is None:
        raise ScenarioError("sensors.lines needs a map of segments; this run has none")
    walls = segments.segments
    return lambda truth, draws: _read(sensor, truth.robot, walls, draws)


def _read(sensor: LineSensor, robot: RobotState, walls: FloatArray, draws: Draws) -> LineReadings:
    """Return the lines of ``walls`` (S, 4). Each wall has its own draws; each visible part of a wall is a line."""
    noise = draws.standard_normal((len(walls), 2)) * (sensor.rho_std, sensor.alpha_std)
    half = sensor.field_of_view / 2
    angles = np.linspace(-half, half, sensor.beams)
    origin = np.array([robot.x, robot.y])
    ranges = np.stack([ray_segments(origin, robot.theta + angles, wall[None]) for wall in walls])
    nearest = np.argmin(ranges, axis=0)
    distance = ranges[nearest, np.arange(sensor.beams)]
    met = np.where(distance < sensor.max_range, nearest, -1)
    changes = np.flatnonzero(np.diff(met)) + 1
    readings = []
    for beams in np.split(np.arange(sensor.beams), changes):
        wall, first, last = int(met[beams[0]]), beams[0], beams[-1]
        if wall < 0 or len(beams) < sensor.min_beams:
            continue
        sine, cosine = sincos(angles[[first, last]])
        ends = distance[[first, last]] * np.array([cosine, sine])
        (dx, dy), (x, y) = ends[:, 1] - ends[:, 0], ends[:, 0]
        length = hypot(dx, dy)
        if length < max(sensor.min_length, 1e-9):
            continue
        rho = (x * dy - y * dx) / length + noise[wall, 0]
        alpha = atan2(-dx, dy) + noise[wall, 1]
        if rho < 0.0:
            rho, alpha = -rho, alpha + math.pi
        readings.append(LineReading(rho=float(rho), alpha=math.remainder(alpha, math.tau), length=length))
    return LineReadings(readings=tuple(readings[:256]))


def _lines(message: LineReadings, _: None) -> Lines:
    columns = ([getattr(reading, name) for reading in message.readings] for name in ("rho", "alpha", "length"))
    return Lines(*(np.array(column, dtype=np.float32) for column in columns))


def _example(maps: Any, pose: Floats, _model: Any) -> LineReadings | None:
    if maps.segments is None:
        return None
    found = polar_in_frame(maps.segments.rho, maps.segments.alpha, pose.astype(np.float64))
    rho, alpha = (float(values[0]) for values in found)
    return LineReadings(readings=(LineReading(rho=rho, alpha=alpha, length=0.0),))


LINES = SensorKind(
    name="lines",
    message=LineReadings,
    simulated=Simulated(LineSensor, _made),
    readings=(ReadingKind(Lines, _lines, _example, lambda lines: len(lines.rho)),),
    models=(ModelKind(PolarLinesParams, Lines, PolarLines, "segments"),),
)
