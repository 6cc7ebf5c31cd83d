"""Runs of the room scenarios for studies: what a robot saw and did on its way, and what filters make of it; no bus."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import LandmarkReadings, LaserScan, Odometry, OdometryPose, RobotState
from dynpf_runtime.node import Received, Step
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.schema import Scenario
from dynpf_systems.rooms.config import Door, RoomConfig
from dynpf_systems.rooms.localization.components import Moved, localizer_of, measurements_of, motion_of
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.readings import TOPICS, reading_of
from dynpf_systems.rooms.maps import Maps, open_maps
from dynpf_systems.rooms.sensors.config import SimulatedSensorsConfig
from dynpf_systems.rooms.sensors.simulated import SimulatedSensors
from dynpf_systems.rooms.steering import Route
from dynpf_systems.rooms.world import RoomSimulator

from dynpf.filters.models import Models
from dynpf.filters.start import FromReadingsStart, KnownStart, start_poses
from dynpf.measurement.model import MeasurementModel
from dynpf.measurement.scan import Scan
from dynpf.motion.model import Displacement, Twist
from dynpf.motion.odometry import OdometryParams
from dynpf.rng import Stream, generator
from dynpf.se2 import FloatArray, Floats, arc_displacement, compose, relative, wrap_angle

__all__ = [
    "Drive",
    "Epoch",
    "Track",
    "World",
    "dead_reckoning",
    "follow",
    "known_start",
    "measures",
    "played",
    "readings_of",
    "record",
    "scans",
    "world",
]

NEAR_M, NEAR_RAD = 0.5, math.radians(15.0)
"""A pose estimate within these of the truth is right."""
REFERENCE_NS = 10_000_000
"""Between a scan of a log and the reference pose that is taken for its own."""
LASTING = 10
"""Updates for which it has to stay right."""


class World(NamedTuple):
    """A scenario and its maps."""

    name: str
    scenario: Scenario
    maps: Maps
    range_max: float  # m, which a beam without return reads


class Epoch(NamedTuple):
    """What odometry said since the last scan, and what was seen at its end; ``truth`` is the pose there (3,)."""

    controls: tuple[Twist | Moved, ...]
    messages: tuple[LaserScan | LandmarkReadings, ...]
    truth: FloatArray


class Track(NamedTuple):
    """Estimates (3, T), standard deviation of the position (T,) along its worst direction, particles that there were
    (T,), and, where asked for, some of the particles (3, M) at each update.
    """

    poses: FloatArray
    sigmas: FloatArray
    counts: FloatArray
    clouds: Sequence[Floats] = ()


@lru_cache(maxsize=16)
def world(name: str, overrides: tuple[str, ...] = ()) -> World:
    """Return the world of a scenario."""
    scenario = load_scenario(name, overrides=overrides)
    marks = scenario.landmarks or None
    assert isinstance(scenario.sensors, SimulatedSensorsConfig)
    assert scenario.sensors.scan is not None
    return World(name, scenario, open_maps(scenario.map, marks, lambda _: b""), scenario.sensors.scan.range_max)


def record(place: World, seed: int, updates: int, panels: Sequence[Door] = ()) -> list[Epoch]:
    """Return so many epochs of a drive round the scenario's route, which begins somewhere else for each seed.

    ``panels``: doors besides those of the scenario.
    """
    scenario = place.scenario
    room, sensors = scenario.simulator, scenario.sensors
    assert isinstance(room, RoomConfig)
    assert isinstance(sensors, SimulatedSensorsConfig)
    assert room.driver is not None
    assert sensors.scan is not None
    start, points = _route(room.driver, seed)
    driver = msgspec.structs.replace(room.driver, points=points, laps=1000)
    config = msgspec.structs.replace(room, start=start, driver=driver, doors=(*room.doors, *panels))
    tick_s, tick_ns = scenario.tick_s, scenario.tick_ns
    simulator = RoomSimulator(
        config=config, seed=seed, tick_s=tick_s, landmarks=scenario.landmarks or (), maps=place.maps
    )
    node = SimulatedSensors(
        config=sensors, seed=seed, tick_s=tick_s, landmarks=scenario.landmarks or (), maps=place.maps
    )
    epochs: list[Epoch] = []
    twists: list[Twist] = []
    held: Twist | None = None
    tick = 0
    while len(epochs) < updates:
        outputs = simulator.step(Step(tick, tick, tick * tick_ns, ())).outputs
        truth = next(one.message for one in outputs if isinstance(one.message, RobotState))
        inputs = ((one.topic, one.message) for one in outputs)
        received = tuple(Received(topic, "simulator", "", tick, tick * tick_ns, message) for topic, message in inputs)
        sensed = [one.message for one in node.step(Step(tick, tick, tick * tick_ns, received)).outputs]
        if held is not None:
            twists.append(held)
        messages = tuple(one for one in sensed if isinstance(one, LaserScan | LandmarkReadings))
        if any(isinstance(one, LaserScan) for one in messages):
            epochs.append(Epoch(tuple(twists), messages, np.array([truth.x, truth.y, truth.theta])))
            twists = []
        said = next(one for one in sensed if isinstance(one, Odometry))
        held = Twist(said.v, said.w, tick_s)
        tick += 1
    return epochs


def _route(route: Route, seed: int) -> tuple[tuple[float, float, float], tuple[tuple[float, float], ...]]:
    """Return a start on the way between two waypoints, and the points from there on, either way round."""
    rng = generator(seed, "studies", 0, "route")
    points = list(route.points) if rng.random() < 0.5 else list(route.points)[::-1]
    first = int(rng.integers(len(points)))
    points = points[first:] + points[:first]
    (x1, y1), (x2, y2) = points[-1], points[0]
    share = rng.uniform(0.2, 0.8)
    heading = math.atan2(y2 - y1, x2 - x1) + 0.3 * float(rng.standard_normal())
    start = (x1 + share * (x2 - x1), y1 + share * (y2 - y1), math.remainder(heading, math.tau))
    return start, tuple(points)


def known_start(epochs: Sequence[Epoch], seed: int, sigma_position: float, sigma_heading: float) -> KnownStart:
    """Return what somebody who measured the first pose by hand would say of it."""
    off = generator(seed, "studies", 0, "start").standard_normal(3)
    x, y, theta = (epochs[0].truth + off * [sigma_position, sigma_position, sigma_heading]).tolist()
    return KnownStart(x=x, y=y, theta=theta, sigma_position=sigma_position, sigma_heading=sigma_heading)


def dead_reckoning(epochs: Sequence[Epoch]) -> FloatArray:
    """Return where odometry alone puts the robot (3, T), from its true start."""
    poses = [epochs[0].truth]
    for epoch in epochs[1:]:
        pose = poses[-1]
        for control in epoch.controls:
            if isinstance(control, Moved):
                pose = compose(pose, np.array(control.displacement))
            else:
                pose = compose(pose, arc_displacement(control.v * control.duration, control.w * control.duration))
        poses.append(pose)
    return np.stack(poses, axis=1)


def readings_of(
    place: World, config: LocalizationConfig, epoch: Epoch, models: Mapping[type, MeasurementModel[Any]]
) -> list[Any]:
    """Return what was seen at the end of an epoch as the readings that measurement models take."""
    kinds = {TOPICS[kind]: kind for kind in models}
    topics = [("sensors/scan" if isinstance(one, LaserScan) else "sensors/landmarks", one) for one in epoch.messages]
    return [
        reading_of(one, kinds[topic], range_min=config.scan_range_min, range_max=place.range_max)
        for topic, one in topics
        if topic in kinds
    ]


def follow(place: World, config: LocalizationConfig, epochs: Sequence[Epoch], seed: int, *, shown: int = 0) -> Track:
    """Return what the scenario's estimator, configured so, makes of a drive; ``shown``: particles to keep of each."""
    motion = motion_of(config, place.maps, {})
    models = measurements_of(config, place.maps, {})
    localizer = localizer_of(config, motion.model, models, place.maps, {})
    poses = start_poses(
        config.start,
        config.n,
        Stream.of(seed, "study", 0, "start"),
        grid=place.maps.grid,
        models=Models(motion.model, models),
        readings=readings_of(place, config, epochs[0], models),
    )
    belief = localizer.start(poses, Stream.of(seed, "study", 0, "cloud"))
    found, sigmas, counts, clouds = [], [], [], []
    # A start from readings has used the first ones up.
    used = isinstance(config.start, FromReadingsStart)
    for number, epoch in enumerate(epochs):
        stream = Stream.of(seed, "study", number, "update")
        for part, held in enumerate(epoch.controls[:-1]):
            belief = localizer.predict(belief, motion.control(held), stream.part("predict").part(part))
        if number == 0 and used:
            one = localizer.find(belief)
        else:
            control = motion.control(epoch.controls[-1]) if epoch.controls else None
            belief, one = localizer.update(belief, control, readings_of(place, config, epoch, models), stream)
        found.append(one.estimate.mean[:3])
        sigmas.append(math.sqrt(float(np.linalg.eigvalsh(one.estimate.covariance[:2, :2])[-1])))
        counts.append(belief.weights.size)
        if shown:
            clouds.append(np.array(localizer.shown(belief, shown)))
    return Track(np.stack(found, axis=1), np.array(sigmas), np.array(counts, dtype=np.float64), clouds)


def measures(epochs: Sequence[Epoch], poses: FloatArray, *, whole: bool = False) -> dict[str, float | bool]:
    """Return success, errors, and the update from which on the poses (3, T) were right for ten on end.

    Success is to be right at each of the last ten. Errors are those from convergence on, or, if there is none, or if
    the ``whole`` is asked for, of all the way.
    """
    truth = np.stack([epoch.truth for epoch in epochs], axis=1)
    distance = np.hypot(*(poses[:2] - truth[:2]))
    turn = np.abs(wrap_angle(poses[2] - truth[2]))
    right = (distance < NEAR_M) & (turn < NEAR_RAD)
    success = bool(right[-LASTING:].all())
    lasting = np.flatnonzero(np.convolve(right, np.ones(LASTING), "valid") == LASTING)
    first = int(lasting[0]) if lasting.size and not whole else 0
    return {
        "success_percent": success,
        "position_rmse_m": float(np.sqrt(np.mean(distance[first:] ** 2))),
        "heading_rmse_rad": float(np.sqrt(np.mean(turn[first:] ** 2))),
        "updates_to_converge": float(first + 1) if lasting.size and success else math.nan,
    }


def scans(place: World, epochs: Sequence[Epoch]) -> Iterator[tuple[FloatArray, Scan]]:
    """Yield the scans of a drive, each with the true pose (3,)."""
    for epoch in epochs:
        for message in epoch.messages:
            if isinstance(message, LaserScan):
                yield epoch.truth, reading_of(message, Scan, range_max=place.range_max)


class Drive(NamedTuple):
    """An imported log as a study takes it."""

    place: World
    epochs: Sequence[Epoch]

    def stretch(self, seed: int, updates: int) -> list[Epoch]:
        """Return so many epochs on end from another place of the log for each seed."""
        last = len(self.epochs) - updates
        if last < 0:
            raise UsageError(f"the log has {len(self.epochs)} scans with a reference; expected {updates} or more")
        first = int(generator(seed, "studies", 0, "stretch").integers(last + 1))
        return [self.epochs[first]._replace(controls=()), *self.epochs[first + 1 : first + updates]]


@lru_cache(maxsize=2)
def played(path: Path, scenario: str = "laser-log", moved_m: float = 0.25, turned_rad: float = 0.2) -> Drive:
    """Return a log in its own map; of its scans, those that come when the robot has moved or turned so far.

    Raises UsageError where it has no map or no reference.
    """
    log = PlayedLog(path)
    facts = log.facts
    if facts.map is None or facts.range_max is None:
        raise UsageError(f"{path}: holds no map or no scans; dynpf import carmen|rosbag --map makes such a recording")
    resolved = load_scenario(scenario, log=facts)
    assert isinstance(resolved.estimator, LocalizationConfig)
    # The scenario's noise is for every record of odometry; here there is one movement from scan to scan.
    estimator = msgspec.structs.replace(resolved.estimator, motion=OdometryParams())
    resolved = msgspec.structs.replace(resolved, estimator=estimator)
    maps = open_maps(resolved.map, None, lambda name: facts.files[name.rpartition("/")[2]])
    epochs: list[Epoch] = []
    odometry: FloatArray | None = None  # the last pose of odometry
    taken: FloatArray | None = None  # that of the last epoch
    stamp_ns, truth_ns, truth, scan = 0, -1, None, None
    for one in log.records:
        match decode(one.topic, one.payload):
            case OdometryPose(x=x, y=y, theta=theta):
                odometry = np.array([x, y, theta])
            case LaserScan() as message if odometry is not None:
                scan, stamp_ns = message, one.stamp_ns
            case RobotState(x=x, y=y, theta=theta):
                truth, truth_ns = np.array([x, y, theta]), one.stamp_ns
        if scan is None or odometry is None or truth is None or abs(truth_ns - stamp_ns) > REFERENCE_NS:
            continue
        step = None if taken is None else relative(taken, odometry)
        if step is None or math.hypot(*step[:2]) >= moved_m or abs(step[2]) >= turned_rad:
            controls = () if step is None else (Moved(Displacement(*step.tolist()), 1.0),)
            epochs.append(Epoch(controls, (scan,), truth))
            taken = odometry
        scan = None
    return Drive(World(path.stem, resolved, maps, float(facts.range_max)), epochs)
