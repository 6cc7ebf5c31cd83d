"""Runs of the room scenarios for studies: a robot's drive, and estimators that follow it."""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.drive import drive, follow_inputs, inputs_of
from dynpf_experiments.messages import RunMessages, of_type, planar_poses
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import (
    Estimate,
    LandmarkReadings,
    LaserScan,
    Message,
    Odometry,
    OdometryPose,
    PosesInFrame,
    RobotState,
    Scanner,
)
from dynpf_runtime.node import Node, Step
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import LogContent
from dynpf_services.scenario.schema import Scenario
from dynpf_services.sensors.simulated import SimulatedSensorsConfig

from dynpf.filters.start import KnownStart
from dynpf.measurement.scan import Scan
from dynpf.motion.model import Displacement, Twist
from dynpf.rng import generator
from dynpf.se2 import arc_displacement, compose, relative, wrap_angle
from dynpf.types import FloatArray
from dynpf_systems.rooms.config import Door, RoomConfig
from dynpf_systems.rooms.localization.components import Moved
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.estimator import LocalizationEstimator
from dynpf_systems.rooms.localization.readings import reading_of
from dynpf_systems.rooms.maps import Maps, open_maps
from dynpf_systems.rooms.measures import FOUND_M, FOUND_RAD
from dynpf_systems.rooms.steering import Route
from dynpf_systems.rooms.studies.laser_logs import LaserLog, Record, encoded, log_named
from dynpf_systems.rooms.studies.laser_runs import UpdateCount

__all__ = [
    "SEARCH_COLUMNS",
    "Drive",
    "Epoch",
    "Track",
    "Way",
    "World",
    "dead_reckoning",
    "follow",
    "known_start",
    "load_world",
    "measures",
    "played",
    "record",
    "scans",
]

LASTING = 10
"""Number of updates for which an estimate has to stay right."""

SEARCH_COLUMNS = (
    ("dataset", "", "dataset"),
    ("case", "", "case"),
    ("start", "", "start"),
    ("filter", "", "filter"),
    ("n", "", "n"),
    ("trials", "", "trials"),
    ("success %", ".0f", "success_percent"),
    ("95 %", ".0f", "success_percent_ci_low success_percent_ci_high"),
    ("updates", ".0f", "updates_to_converge_median"),
    ("position m", ".3f", "position_rmse_m_median position_rmse_m_p95"),
    ("heading rad", ".4f", "heading_rmse_rad_median"),
)
"""What the tables of studies tell of filters that find the robot, or track it, on such ways."""

_SENSED = ("truth/robot", "sensors/odometry", "sensors/scan", "sensors/landmarks")


class World(NamedTuple):
    """A scenario, its maps, and its scanner's limits."""

    name: str
    scenario: Scenario
    maps: Maps
    scanner: Scanner


class Epoch(NamedTuple):
    """Odometry since the last scan, and the messages at its end, where the true pose (3,) is ``truth``."""

    stamp_ns: int
    controls: tuple[Twist | Moved, ...]
    messages: tuple[LaserScan | LandmarkReadings, ...]
    truth: FloatArray


class Way(NamedTuple):
    """A robot's drive through a world: the run of ``scenario`` with any estimator, by epochs.

    ``steps`` are the estimator's inputs; a drive of a log has ``records`` instead. ``maps`` are the estimator's maps,
    where the scenario cannot name them.
    """

    scenario: Scenario
    epochs: Sequence[Epoch]
    steps: Sequence[Step]
    records: Sequence[Record] = ()
    maps: Maps | None = None


class Track(NamedTuple):
    """Estimates (3, T), greatest standard deviation of the position (T,) and number of particles (T,), at each update;
    and, on request, some of the particles (3, M) of each.
    """

    poses: FloatArray
    sigmas: FloatArray
    counts: FloatArray
    clouds: Sequence[FloatArray] = ()


@lru_cache(maxsize=16)
def load_world(name: str, overrides: tuple[str, ...] = ()) -> World:
    """Return the world of a scenario."""
    scenario = load_scenario(name, overrides=overrides)
    marks = scenario.landmarks or None
    assert isinstance(scenario.sensors, SimulatedSensorsConfig)
    scan = scenario.sensors.scan
    assert scan is not None
    scanner = Scanner(range_min=scan.range_min, range_max=scan.range_max)
    return World(name, scenario, open_maps(scenario.map, marks, lambda _: b""), scanner)


def record(world: World, seed: int, updates: int, panels: Sequence[Door] = ()) -> Way:
    """Return a drive of ``updates`` scans along the scenario's route, whose start depends on the seed.

    ``panels`` are doors besides those of the scenario.
    """
    room, sensors = world.scenario.simulator, world.scenario.sensors
    assert isinstance(room, RoomConfig)
    assert isinstance(sensors, SimulatedSensorsConfig)
    assert room.driver is not None
    assert sensors.scan is not None
    start, points = _route(room.driver, seed)
    driver = msgspec.structs.replace(room.driver, points=points, laps=1000)
    scenario = world.scenario.changed(
        seed=seed,
        simulator=msgspec.structs.replace(room, start=start, driver=driver, doors=(*room.doors, *panels)),
        max_ticks=(updates - 1) * sensors.scan.every + 1,
    )
    run, steps = inputs_of(scenario, "estimator", _SENSED)
    return Way(scenario, _epochs(run), steps)


def _epochs(run: RunMessages) -> list[Epoch]:
    """Return the epochs between scans; each twist holds until the next, a tick later."""
    tick_s = run.scenario.tick_s
    truth = {timed.stamp_ns: timed.message for timed in run.topic("truth/robot")}
    landmarks = {timed.stamp_ns: timed.message for timed in run.topic("sensors/landmarks")}
    scanned = {timed.stamp_ns: timed.message for timed in run.topic("sensors/scan")}
    epochs: list[Epoch] = []
    twists: list[Twist] = []
    held: Twist | None = None
    odometry = run.topic("sensors/odometry")
    for timed, reading in zip(odometry, of_type(odometry, Odometry), strict=True):
        twists += [held] if held is not None else []
        held = Twist(reading.v, reading.w, tick_s)
        at = timed.stamp_ns
        if at in scanned:
            seen = tuple(_seen(scanned[at], landmarks.get(at)))
            epochs.append(Epoch(at, tuple(twists), seen, _pose(truth[at])))
            twists = []
    return epochs


def _seen(*messages: Message | None) -> Iterator[LaserScan | LandmarkReadings]:
    return (message for message in messages if isinstance(message, LaserScan | LandmarkReadings))


def _pose(message: Message) -> FloatArray:
    assert isinstance(message, RobotState)
    return np.array([message.x, message.y, message.theta])


def _route(route: Route, seed: int) -> tuple[tuple[float, float, float], tuple[tuple[float, float], ...]]:
    """Return a start between two waypoints, and the waypoints from there on, in either direction."""
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
    """Return a start drawn from a Gaussian around the first true pose."""
    off = generator(seed, "studies", 0, "start").standard_normal(3)
    x, y, theta = (epochs[0].truth + off * [sigma_position, sigma_position, sigma_heading]).tolist()
    return KnownStart(x=x, y=y, theta=theta, sigma_position=sigma_position, sigma_heading=sigma_heading)


def dead_reckoning(epochs: Sequence[Epoch]) -> FloatArray:
    """Return the poses (3, T) by odometry alone, from the true start."""
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


def follow(way: Way, config: LocalizationConfig, *, shown: bool = False) -> Track:
    """Return the track of an estimator on a drive: its estimate at each epoch's scan; with ``shown`` also particles."""
    scenario = way.scenario.changed(estimator=config)
    topics = ("estimator/state", "estimator/particles") if shown else ("estimator/state",)
    if way.steps:
        run = follow_inputs(scenario, "estimator", way.steps, topics)
    else:
        log = LogContent(encoded(way.records))
        others: dict[str, Node] = {}
        if way.maps is not None:
            others["estimator"] = LocalizationEstimator(config=config, seed=scenario.seed, maps=way.maps, classes={})
        run = drive(scenario, topics, log, others=others)
    by_stamp = {timed.stamp_ns: timed.message for timed in run.topic("estimator/state")}
    estimates = [by_stamp[epoch.stamp_ns] for epoch in way.epochs]
    poses, sigmas, counts = [], [], []
    for estimate in estimates:
        assert isinstance(estimate, Estimate)
        poses.append((estimate.x, estimate.y, estimate.theta))
        covariance = np.reshape(estimate.covariance, (3, 3))[:2, :2]
        sigmas.append(math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])))
        counts.append(_particles(estimate))
    clouds = list(_clouds(run, way.epochs)) if shown else []
    return Track(np.array(poses).T, np.array(sigmas), np.array(counts), clouds)


def _particles(estimate: Estimate) -> float:
    """Return the number of particles, from the effective sample size and its share of them."""
    share = estimate.health.figures.n_eff_share if estimate.health else msgspec.UNSET
    return round(estimate.n_eff / share) if isinstance(share, float) and share > 0.0 else math.nan


def _clouds(run: RunMessages, epochs: Sequence[Epoch]) -> Iterator[FloatArray]:
    """Yield the particles (3, M) published last at each epoch's scan."""
    known = run.topic("estimator/particles")
    stamps = np.array([timed.stamp_ns for timed in known])
    newest = np.searchsorted(stamps, [epoch.stamp_ns for epoch in epochs], side="right") - 1
    messages = of_type(known, PosesInFrame)
    for index in newest.tolist():
        yield planar_poses(messages[index].poses)


def measures(epochs: Sequence[Epoch], poses: FloatArray, *, whole: bool = False) -> dict[str, float | bool]:
    """Return success, errors, and the update from which the poses (3, T) were right ten times in a row.

    Success is to be right at each of the last ten updates. Errors count from convergence on; without convergence, or
    with ``whole``, over the whole drive.
    """
    truth = np.stack([epoch.truth for epoch in epochs], axis=1)
    distance = np.hypot(*(poses[:2] - truth[:2]))
    turn = np.abs(wrap_angle(poses[2] - truth[2]))
    right = (distance < FOUND_M) & (turn < FOUND_RAD)
    success = bool(right[-LASTING:].all())
    lasting = np.flatnonzero(np.convolve(right, np.ones(LASTING), "valid") == LASTING)
    first = int(lasting[0]) if lasting.size and not whole else 0
    return {
        "success_percent": success,
        "position_rmse_m": float(np.sqrt(np.mean(distance[first:] ** 2))),
        "heading_rmse_rad": float(np.sqrt(np.mean(turn[first:] ** 2))),
        "updates_to_converge": float(first + 1) if lasting.size and success else math.nan,
    }


def scans(world: World, epochs: Sequence[Epoch]) -> Iterator[tuple[FloatArray, Scan]]:
    """Yield the true pose (3,) and the scan of each epoch."""
    for epoch in epochs:
        for message in epoch.messages:
            if isinstance(message, LaserScan):
                yield epoch.truth, reading_of(message, Scan, world.scanner)


class Drive(NamedTuple):
    """An imported log with its epochs; ``starts`` are the indices of the epochs' scans among its records."""

    world: World
    log: LaserLog
    epochs: Sequence[Epoch]
    starts: Sequence[int]

    def stretch(self, seed: int, updates: int) -> Way:
        """Return ``updates`` consecutive epochs of the log, from a start that depends on the seed."""
        last = len(self.epochs) - updates
        if last < 0:
            raise UsageError(f"the log has {len(self.epochs)} scans with a reference; expected {updates} or more")
        first = int(generator(seed, "studies", 0, "stretch").integers(last + 1))
        epochs = [self.epochs[first]._replace(controls=()), *self.epochs[first + 1 : first + updates]]
        records = self.log.records[self.starts[first] : self.starts[first + updates - 1] + 1]
        return Way(msgspec.structs.replace(self.world.scenario, seed=seed), epochs, (), records)


@lru_cache(maxsize=2)
def played(path: Path, scenario: str = "laser-log", moved_m: float = 0.25, turned_rad: float = 0.2) -> Drive:
    """Return a log in its own map, with the scans after which the robot has moved or turned by so much.

    Raises UsageError where it has no map or no reference.
    """
    log = log_named(str(path))
    facts, scanner = log.facts, log.scanner
    if facts.map is None or scanner is None:
        raise UsageError(f"{path}: holds no map or no scans; dynpf import carmen|rosbag --map makes such a recording")
    chosen = (f"estimator.min_travel={moved_m}", f"estimator.min_turn={turned_rad}")
    resolved = load_scenario(scenario, overrides=chosen, log=facts)
    assert isinstance(resolved.estimator, LocalizationConfig)
    maps = open_maps(resolved.map, None, lambda name: facts.files[name.rpartition("/")[2]])
    epochs: list[Epoch] = []
    starts: list[int] = []
    count = UpdateCount(msgspec.structs.replace(resolved.estimator, start=KnownStart()))
    odometry = taken = np.zeros(3)  # the last pose of odometry, and the pose of the last epoch
    for index, record in enumerate(log.records):
        before = count.updates
        count.see(record.message)
        if isinstance(record.message, OdometryPose):
            odometry = np.array([record.message.x, record.message.y, record.message.theta])
        if isinstance(record.message, LaserScan) and count.updates > before and record.truth is not None:
            step = relative(taken, odometry).tolist()
            controls = (Moved(Displacement(*step), 1.0),) if epochs else ()
            epochs.append(Epoch(record.stamp_ns, controls, (record.message,), np.array(record.truth)))
            starts.append(index)
            taken = odometry
    return Drive(World(path.stem, resolved, maps, scanner), log, epochs, starts)
