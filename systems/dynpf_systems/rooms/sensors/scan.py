"""Range scans and their scanner's limits: simulated, from logs, and as filters take them."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import LaserScan, Message, Scanner, heading, planar_pose, timestamp
from dynpf_services.scenario.context import Context
from dynpf_services.sensors.kind import (
    After,
    Announced,
    ModelKind,
    ReadingKind,
    SensorKind,
    SensorTable,
    Simulated,
    Truth,
    passed,
)
from msgspec import Meta

from dynpf.maps.raycast import RayCaster
from dynpf.measurement.beam import BeamModel, BeamParams
from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.range_vector import RangeVector, RangeVectorModel, RangeVectorParams
from dynpf.measurement.ray import ray_discs, ray_segments
from dynpf.measurement.scan import Scan
from dynpf.measurement.scan_lines import ScanLines, ScanLinesParams
from dynpf.rng import Draws
from dynpf.types import FloatArray, Floats, NonNegative, Positive
from dynpf_systems.rooms.maps import Maps, maps_of
from dynpf_systems.rooms.messages import Obstacles
from dynpf_systems.rooms.sensors.view import FieldOfView

__all__ = ["SCAN", "SCANNER", "ScanSensor"]

Rays = Callable[[FloatArray, FloatArray], FloatArray]
"""Distances (B,) from an origin (2,) along angles (B,) of the map frame to the nearest wall, infinite without one."""

OBSTACLES = "truth/obstacles"
BEAMS = 5
"""Number of beams of the scan in a rehearsal."""


class ScanSensor(SensorTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ranges from the robot's centre to walls, parts, people and closed doors, on beams spread over the field of view.

    The walls are those given here, else the map's, else those of the world, such as the border of a task's workspace.
    The noise's standard deviation is range_std + range_std_per_square_metre range^2, as for a structured-light camera.
    """

    beams: Annotated[int, Meta(ge=2, le=100_000)] = 60
    field_of_view: FieldOfView = 3 * math.pi / 2  # rad, first to last beam, centred on the heading
    range_min: NonNegative = 0.0  # m; nearer obstacles give no reading, which is 0
    range_max: Positive = 4.0  # m; also the reading of a beam without return
    range_std: NonNegative = 0.01  # m
    range_std_per_square_metre: NonNegative = 0.0  # 1/m
    glass: tuple[tuple[float, float, float, float], ...] = ()  # walls of the map, as it has them, that beams go through
    walls: tuple[tuple[float, float, float, float], ...] = ()  # x1, y1, x2, y2 in m


class _Simulated:
    """A scanner in a run's world."""

    def __init__(self, sensor: ScanSensor, context: Context) -> None:
        self._sensor = sensor
        self._worlds = context.surroundings()
        walls = [world.walls(table) for world, table in self._worlds]
        self._walls = _rays(sensor, maps_of(context), np.concatenate(walls) if walls else None)

    def __call__(self, truth: Truth, draws: Draws) -> LaserScan:
        """Return the scan; a beam without return reads exactly range_max, one that ends below range_min reads 0."""
        sensor, robot = self._sensor, truth.robot
        half = sensor.field_of_view / 2
        angles = robot.theta + np.linspace(-half, half, sensor.beams)
        origin = np.array([robot.x, robot.y])
        ranges = self._walls(origin, angles)
        for discs in self._discs(truth.others):
            ranges = np.minimum(ranges, ray_discs(origin, angles, discs))
        obstacles = truth.others.get(OBSTACLES)
        if isinstance(obstacles, Obstacles):
            doors = np.array([(door.x1, door.y1, door.x2, door.y2) for door in obstacles.doors]).reshape(-1, 4)
            ranges = np.minimum(ranges, ray_segments(origin, angles, doors))
        returned = ranges < sensor.range_max
        true = np.where(returned, ranges, sensor.range_max)
        std = sensor.range_std + sensor.range_std_per_square_metre * (true * true)
        read = np.clip(true + std * draws.standard_normal(sensor.beams), 0.0, sensor.range_max)
        ranges = np.where(returned, np.where(true < sensor.range_min, 0.0, read), sensor.range_max)
        return _scan(truth.stamp_ns, half, tuple(ranges.tolist()))

    def _discs(self, truth: Mapping[str, Message]) -> Iterator[FloatArray]:
        """Yield the discs that block beams, (D, 3): people, and the discs of the run's world."""
        obstacles = truth.get(OBSTACLES)
        if isinstance(obstacles, Obstacles):
            yield np.array([(person.x, person.y, person.radius) for person in obstacles.people]).reshape(-1, 3)
        for world, _ in self._worlds:
            if world.topic in truth:
                yield world.discs(truth[world.topic])

    def rehearse(self) -> None:
        """See Rehearsing."""
        self._walls(np.zeros(2), np.zeros(1))
        ray_discs(np.zeros(2), np.zeros(1), np.zeros((0, 3)))
        ray_segments(np.zeros(2), np.zeros(1), np.zeros((0, 4)))


def _scan(stamp_ns: int, half: float, ranges: tuple[float, ...]) -> LaserScan:
    return LaserScan(
        timestamp=timestamp(stamp_ns),
        frame_id=frames.ROBOT,
        pose=planar_pose(0.0, 0.0, 0.0),
        start_angle=-half,
        end_angle=half,
        ranges=ranges,
    )


def _seen(context: Context) -> dict[str, type[Message]]:
    return {OBSTACLES: Obstacles, **{world.topic: world.type for world, _ in context.surroundings()}}


def _rays(sensor: ScanSensor, maps: Maps, others: FloatArray | None) -> Rays:
    """Return the ranges of beams to the scanner's own walls, else to the map's, else to those of the run's world."""
    if sensor.glass and (sensor.walls or maps.segments is None):
        raise ScenarioError("sensors.scan.glass: needs a map of segments; the walls of this scan are from elsewhere")
    if sensor.walls:
        return _to_segments(np.array(sensor.walls, dtype=np.float64))
    if maps.segments is not None:
        return _to_segments(_opaque(maps.segments.segments, sensor.glass))
    if maps.grid is not None:
        return _to_cells(RayCaster(maps.grid), sensor.range_max)
    if others is not None:
        return _to_segments(others)
    raise ScenarioError("sensors.scan needs walls, a map, or a world that has walls; this run has none of them")


def _opaque(walls: FloatArray, glass: Sequence[tuple[float, float, float, float]]) -> FloatArray:
    """Return the walls that are not glass; raises ScenarioError for glass that is not a wall of the map."""
    opaque = np.ones(len(walls), dtype=bool)
    for index, pane in enumerate(glass):
        same = (walls == np.array(pane)).all(axis=1)
        if not same.any():
            raise ScenarioError(f"sensors.scan.glass.{index}: {list(pane)} is no segment of the map")
        opaque &= ~same
    return walls[opaque]


def _to_segments(walls: FloatArray) -> Rays:
    return lambda origin, angles: ray_segments(origin, angles, walls)


def _to_cells(caster: RayCaster, range_max: float) -> Rays:
    def rays(origin: FloatArray, angles: FloatArray) -> FloatArray:
        """Return the ranges by ray casting in the grid."""
        x, y = np.broadcast_to(origin.astype(np.float32)[:, None], (2, angles.size)).copy()
        return caster.ranges(x, y, angles.astype(np.float32), range_max).astype(np.float64)

    return rays


def _whole(message: LaserScan, scanner: Scanner) -> Scan:
    ranges = np.array(message.ranges, dtype=np.float32)
    angles = np.linspace(message.start_angle, message.end_angle, len(ranges), dtype=np.float32)
    mount = message.pose.position
    pose = (mount.x, mount.y, heading(message.pose.orientation))
    return Scan(angles, ranges, scanner.range_min, scanner.range_max, pose)


def _vector(message: LaserScan, scanner: Scanner) -> RangeVector:
    ranges = np.array(message.ranges, dtype=np.float32)
    return RangeVector(np.where(ranges < scanner.range_max, ranges, np.float32(np.inf)))


def _example(_maps: Any, _pose: Floats, model: Any) -> LaserScan:
    beams = len(model.params.angles) if isinstance(model, RangeVectorModel) else BEAMS
    return _scan(0, 1.0, (1.0,) * beams)


def _good(scan: LaserScan) -> bool:
    numbers = (scan.start_angle, scan.end_angle, *scan.ranges)
    return bool(scan.ranges) and all(map(math.isfinite, numbers)) and min(scan.ranges) >= 0.0


SCANNER = SensorKind(
    name="scanner",
    message=Scanner,
    checked=passed(
        lambda announced: math.isfinite(announced.range_max) and 0.0 <= announced.range_min < announced.range_max
    ),
)

SCAN = SensorKind(
    name="scan",
    message=LaserScan,
    simulated=Simulated(ScanSensor, _Simulated, _seen),
    announced=Announced("scanner", lambda sensor: Scanner(range_min=sensor.range_min, range_max=sensor.range_max)),
    checked=passed(_good),
    readings=(
        ReadingKind(Scan, _whole, _example, after=After("scanner", Scanner(range_max=10.0))),
        ReadingKind(RangeVector, _vector, _example, after=After("scanner", Scanner(range_max=10.0))),
    ),
    models=(
        ModelKind(LikelihoodFieldParams, Scan, LikelihoodField, "grid"),
        ModelKind(BeamParams, Scan, BeamModel, "grid"),
        ModelKind(RangeVectorParams, RangeVector, RangeVectorModel, "grid"),
        ModelKind(ScanLinesParams, Scan, ScanLines, "segments"),
    ),
)
