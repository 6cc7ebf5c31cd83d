"""Localization in a known map: odometry moves the belief, readings of any sensors correct it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    Estimate,
    HostEvent,
    LandmarkReadings,
    Log,
    LogLevel,
    Odometry,
    OdometryPose,
    PoseInFrame,
    PosesInFrame,
    planar_pose,
    planar_poses,
    timestamp,
)
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, Received, Result, State, Step
from dynpf_services.estimates import gap_warning, robot_transform
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.schema import key_of
from msgspec import UNSET

from dynpf.filters.adaptation import PoseSource
from dynpf.filters.health import Signs
from dynpf.filters.models import Models, Outcome
from dynpf.filters.start import FromReadingsStart, KnownStart, Start, UniformStart, around, pose_source
from dynpf.measurement.range_bearing import RangeBearingReadings
from dynpf.measurement.scan import Scan
from dynpf.motion.model import Displacement, Twist
from dynpf.portable import hypot
from dynpf.rng import Stream
from dynpf.se2 import FloatArray, arc_displacement, compose, relative
from dynpf_systems.rooms.localization.components import Moved, localizer_of, measurements_of, motion_of
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.health import HealthWatch
from dynpf_systems.rooms.localization.localizers import Found
from dynpf_systems.rooms.localization.picture import draw_scene
from dynpf_systems.rooms.localization.readings import TOPICS, is_message, reading_of, size_of
from dynpf_systems.rooms.localization.rehearsal import example_readings
from dynpf_systems.rooms.localization.user_components import Classes
from dynpf_systems.rooms.maps import Maps, maps_of

__all__ = ["LocalizationEstimator", "build"]

NANOSECONDS = 10**9
SHORTEST_NS = NANOSECONDS // 1000  # that a displacement is said to have taken
SHOWN_PARTICLES = 200
REHEARSED_PARTICLES = 64
SHOWN = Every(0.2)
SCENE = Every(1.0)


class _Velocity(NamedTuple):
    """The twist in force: m/s and rad/s."""

    v: float
    w: float


class _TimedTwist(NamedTuple):
    """A twist that holds from ``from_ns`` on."""

    from_ns: int
    v: float
    w: float


class LocalizationEstimator:
    """The estimator of a robot in a known map.

    Inputs are taken in the order given. Each first brings the belief to its own stamp, under the twist that holds
    then; one that comes after the belief has passed its stamp counts as if taken now, save a twist that a newer one
    has overtaken, which is dropped. Odometry that comes as poses moves the belief from pose to pose, whatever their
    stamps. Readings of one instant correct the belief together. The start pose is that of the first input's stamp.
    Raises ScenarioError where the components do not fit each other or the run.
    """

    def __init__(
        self,
        *,
        config: LocalizationConfig,
        seed: int,
        landmarks: Sequence[Landmark] = (),
        maps: Maps,
        classes: Classes,
        scan_range_max: float | None = None,
        name: str = "estimator",
    ) -> None:
        """Take the config, the run's maps and the user's classes by name; ``scan_range_max`` if the config has none."""
        self.name = name
        self._seed = seed
        self._delay_ns = round(config.odometry_delay * NANOSECONDS)
        self._marks = tuple(landmarks)
        self._config, self._maps = config, maps
        key = key_of(name)
        motion = motion_of(config, maps, classes, key)
        measurements = measurements_of(config, maps, classes, key)
        self._control = motion.control
        self._localizer = localizer_of(config, motion.model, measurements, maps, classes, key=key)
        self._start, self._count = config.start, config.n
        self._grid, self._models = maps.grid, Models(motion.model, measurements)
        self._source = _source(config.start, maps, self._models, key)
        self._kinds = {TOPICS[kind]: kind for kind in measurements if kind in TOPICS}
        self._own_kinds = frozenset(kind for kind in measurements if is_message(kind))
        self._known = maps.landmarks if RangeBearingReadings in measurements else None
        range_max = config.scan_range_max or scan_range_max
        if range_max is None and Scan in measurements:
            raise ScenarioError(f"{key}.scan_range_max: missing; a scan does not tell what a beam without return reads")
        self._scanner = {"range_min": config.scan_range_min, "range_max": range_max or np.inf}
        # Of the step that is being taken; empty between steps.
        self._number = 0
        self._draws = 0
        self._held: list[Twist | Moved] = []
        self._pending: list[Any] = []
        self._found: Found | None = None
        self._logs: list[Output] = []
        self._belief: Any = None  # until there are readings to start from
        self._reckoned: FloatArray | None = None
        if isinstance(config.start, KnownStart):
            self._reckoned = np.array([config.start.x, config.start.y, config.start.theta])
        self._begin(())
        self._stamp_ns: int | None = None
        self._twist = _Velocity(0.0, 0.0)
        self._coming: list[_TimedTwist] = []
        self._newest_odometry_ns = -1
        self._odometry_pose: FloatArray | None = None
        self._least = (config.min_travel, config.min_turn)
        self._since: tuple[float, float] | None = None  # way and turn; None before the first readings
        self._shown_ns: int | None = None
        self._scene_ns: int | None = None
        self._outcomes = {outcome.value: 0 for outcome in Outcome}
        self._unknown: list[int] = []
        self._health = HealthWatch(config.health, self.name)

    def step(self, step: Step) -> Result:
        """Take the inputs in; answer with the estimate at the step's stamp, if there were any."""
        if not step.inputs:
            return Result()
        self._number, self._draws, self._found, self._logs = step.number, 0, None, []
        for received in step.inputs:
            self._advance(received.stamp_ns)
            match received.message:
                case Odometry() as odometry:
                    self._take_odometry(received.stamp_ns, odometry)
                case OdometryPose(x=x, y=y, theta=theta):
                    self._take_pose(received.stamp_ns, np.array([x, y, theta]))
                case HostEvent() as gap:
                    self._logs.append(gap_warning(gap, step.stamp_ns, self.name))
                case LandmarkReadings(readings=readings):
                    self._logs += self._unknown_landmarks(
                        received, [one.landmark for one in readings if one.x is UNSET]
                    )
            kind = self._kinds.get(received.topic)
            if type(received.message) in self._own_kinds:
                kind = type(received.message)
            if kind is not None:
                self._pending.append(reading_of(received.message, kind, **self._scanner))
        self._advance(step.stamp_ns)
        self._correct()
        self._predict()
        return Result((*(self._report() if self._belief is not None else ()), *self._logs))

    def rehearse(self) -> None:
        """See Rehearsing; of a user's measurement models, those take part that give a reading by ``example()``."""
        stream = Stream.of(self._seed, self.name, 0, "rehearsal")
        if isinstance(self._start, KnownStart):
            poses = around(self._start, REHEARSED_PARTICLES, stream)
        else:
            base = self._start.base if isinstance(self._start, FromReadingsStart) else self._start
            anywhere = base if isinstance(base, UniformStart) else UniformStart()
            poses = pose_source(anywhere, grid=self._grid).draw(REHEARSED_PARTICLES, (), stream)
        poses[:] = poses[:, :1]  # all in one place: what would be read there is believed
        readings = list(
            example_readings(self._config, self._models.measurements, self._maps, poses[:, 0], **self._scanner)
        )
        if self._source is not None:
            self._source.draw(REHEARSED_PARTICLES, readings, stream)
        control = self._control(Twist(0.01, 0.01, 0.1))
        self._localizer.rehearse(poses, control, readings, stream)

    def freeze(self) -> State:
        """Return the belief, the twists in force and to come, dead reckoning, and what was reported."""
        return {
            "belief": None if self._belief is None else self._localizer.freeze(self._belief),
            "reckoned": self._reckoned,
            "stamp_ns": self._stamp_ns,
            "twist": list(self._twist),
            "coming": [list(twist) for twist in self._coming],
            "newest_odometry_ns": self._newest_odometry_ns,
            "shown_ns": self._shown_ns,
            "scene_ns": self._scene_ns,
            "outcomes": dict(self._outcomes),
            "unknown": list(self._unknown),
            "health": self._health.freeze(),
            **({} if self._odometry_pose is None else {"odometry_pose": self._odometry_pose}),
            **({} if self._least == (0.0, 0.0) else {"since": self._since}),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._belief = None if state["belief"] is None else self._localizer.thaw(state["belief"])
        self._reckoned = None if state["reckoned"] is None else np.array(state["reckoned"])
        self._stamp_ns = state["stamp_ns"]
        self._twist = _Velocity(*state["twist"])
        self._coming = [_TimedTwist(*twist) for twist in state["coming"]]
        self._newest_odometry_ns = state["newest_odometry_ns"]
        pose = state.get("odometry_pose")
        self._odometry_pose = None if pose is None else np.array(pose)
        since = state.get("since")
        self._since = None if since is None else (since[0], since[1])
        self._shown_ns = state["shown_ns"]
        self._scene_ns = state["scene_ns"]
        self._outcomes = dict(state["outcomes"])
        self._unknown = list(state["unknown"])
        self._health.thaw(state["health"])

    def _begin(self, readings: Sequence[Any]) -> None:
        """Begin to believe; a start from readings waits until there are some."""
        if isinstance(self._start, KnownStart):
            poses = around(self._start, self._count, self._stream("start"))
        elif isinstance(self._start, UniformStart) or readings:
            assert self._source is not None
            poses = self._source.draw(self._count, readings, self._stream("start"))
        else:
            return
        self._belief = self._localizer.start(poses, self._stream("start"))

    def _take_odometry(self, stamp_ns: int, odometry: Odometry) -> None:
        if stamp_ns < self._newest_odometry_ns:
            return
        self._newest_odometry_ns = stamp_ns
        self._coming.append(_TimedTwist(stamp_ns + self._delay_ns, odometry.v, odometry.w))
        self._advance(stamp_ns)

    def _take_pose(self, stamp_ns: int, pose: FloatArray) -> None:
        """Move on from the last pose of odometry to this one."""
        start, self._odometry_pose = self._odometry_pose, pose
        since_ns, self._newest_odometry_ns = self._newest_odometry_ns, max(stamp_ns, self._newest_odometry_ns)
        if start is None:
            return
        self._correct()
        step = relative(start, pose)
        duration_ns = max(self._newest_odometry_ns - since_ns, SHORTEST_NS)
        self._held.append(Moved(Displacement(*step.tolist()), duration_ns / NANOSECONDS))
        if self._reckoned is not None:
            self._reckoned = compose(self._reckoned, step)

    def _advance(self, stamp_ns: int) -> None:
        """Come to ``stamp_ns``, through every change of twist on the way."""
        if self._stamp_ns is None:
            self._stamp_ns = stamp_ns
        while self._coming and self._coming[0].from_ns <= max(stamp_ns, self._stamp_ns):
            change = self._coming.pop(0)
            self._hold(change.from_ns)
            self._twist = _Velocity(change.v, change.w)
        self._hold(stamp_ns)

    def _hold(self, stamp_ns: int) -> None:
        """Let the twist in force hold up to ``stamp_ns``; readings that are pending belong to the time before."""
        assert self._stamp_ns is not None
        duration = (stamp_ns - self._stamp_ns) / NANOSECONDS
        if duration <= 0.0:
            return
        self._correct()
        self._stamp_ns = stamp_ns
        if self._odometry_pose is not None:
            return  # poses tell how it moves
        v, w = self._twist
        last = self._held[-1] if self._held else None
        if isinstance(last, Twist) and last[:2] == (v, w):
            self._held[-1] = Twist(v, w, last.duration + duration)
        else:
            self._held.append(Twist(v, w, duration))
        if self._reckoned is not None:
            self._reckoned = compose(self._reckoned, arc_displacement(v * duration, w * duration))

    def _correct(self) -> None:
        """Let the belief follow the twists held, and correct it by the pending readings, if there are any."""
        if not self._pending:
            return
        if self._belief is None:
            self._begin(self._pending)
            self._since = (0.0, 0.0)
            self._held, self._pending = [], []  # the start is made of these readings, and after the movement before
            return
        if self._health.report is None:
            self._judge(self._localizer.find(self._belief))
        if not self._worthwhile():
            self._pending = []
            return
        control = self._control(self._held.pop()) if self._held else None
        self._predict()
        self._belief, self._found = self._localizer.update(self._belief, control, self._pending, self._stream("update"))
        self._since = (0.0, 0.0)
        for outcome in self._found.outcomes:
            self._outcomes[outcome.value] += 1
        self._judge(self._found, self._pending)
        self._pending = []

    def _judge(self, found: Found, readings: Sequence[Any] = ()) -> None:
        """Judge the belief by what an update has found."""
        assert self._stamp_ns is not None
        sizes = [size_of(reading) for reading in readings]
        outright = sum(int(size) for size, one in zip(sizes, found.outcomes, strict=True) if one is Outcome.REFUSED)
        signs = Signs(
            covariance=found.estimate.covariance,
            n_eff=found.share,
            n=1,
            log_evidence=found.log_evidence,
            readings=found.readings,
            refused=max(outright, sum(int(size) for size in sizes) - found.readings),
            modes=self._localizer.modes(self._belief),
            jump=found.jump,
            unfit=found.unfit,
        )
        self._logs += self._health.judge(signs, self._stamp_ns)

    def _predict(self) -> None:
        """Let the belief follow the twists held."""
        if self._since is not None:
            self._since = self._moved()
        for twist in self._held if self._belief is not None else ():
            self._belief = self._localizer.predict(self._belief, self._control(twist), self._stream("predict"))
            self._found = None
        self._held = []

    def _worthwhile(self) -> bool:
        """Return whether the robot has moved far enough since the last correction, or there was none."""
        if self._since is None:
            return True
        travel, turn = self._moved()
        least_travel, least_turn = self._least
        return travel >= least_travel or turn >= least_turn

    def _moved(self) -> tuple[float, float]:
        """Return the way (m) and the turn (rad) since the last correction, back and forth added up."""
        travel, turn = self._since or (0.0, 0.0)
        for one in self._held:
            if isinstance(one, Twist):
                way, angle = one.v * one.duration, one.w * one.duration
            else:
                way, angle = hypot(one.displacement.dx, one.displacement.dy), one.displacement.turn
            travel, turn = travel + abs(way), turn + abs(angle)
        return travel, turn

    def _stream(self, purpose: str) -> Stream:
        """Return the next stream of this step."""
        self._draws += 1
        return Stream.of(self._seed, self.name, self._number, purpose).part(self._draws)

    def _report(self) -> list[Output]:
        assert self._stamp_ns is not None
        found = self._found or self._localizer.find(self._belief)
        if self._health.due(self._stamp_ns):
            self._judge(found)
        health = self._health.report
        assert health is not None
        x, y, theta = found.estimate.mean.tolist()
        when = timestamp(self._stamp_ns)
        outputs = [
            Output(
                "estimator/state",
                Estimate(
                    x=x,
                    y=y,
                    theta=theta,
                    covariance=tuple(found.estimate.covariance.ravel().tolist()),
                    n_eff=found.n_eff,
                    health=health,
                ),
            ),
            Output("estimator/pose", PoseInFrame(timestamp=when, frame_id=frames.MAP, pose=planar_pose(x, y, theta))),
        ]
        if self._reckoned is not None:
            reckoned = PoseInFrame(timestamp=when, frame_id=frames.MAP, pose=planar_pose(*self._reckoned.tolist()))
            outputs.append(Output("estimator/dead_reckoning", reckoned))
        if SHOWN.due(self._stamp_ns, self._shown_ns):
            self._shown_ns = self._stamp_ns
            outputs.append(Output("estimator/particles", self._shown_particles()))
            outputs.append(Output("estimator/transforms", robot_transform(x, y, theta, when)))
        if SCENE.due(self._stamp_ns, self._scene_ns):
            self._scene_ns = self._stamp_ns
            outputs.append(Output("estimator/scene", draw_scene(x, y, theta, self._marks, when, status=health.status)))
        return outputs

    def _shown_particles(self) -> PosesInFrame:
        assert self._stamp_ns is not None
        return PosesInFrame(
            timestamp=timestamp(self._stamp_ns),
            frame_id=frames.MAP,
            poses=planar_poses(self._localizer.shown(self._belief, SHOWN_PARTICLES)),
        )

    def _unknown_landmarks(self, received: Received, landmarks: Sequence[int]) -> list[Output]:
        """Return a warning for each landmark that is not in the map, the first time that it is seen."""
        if self._known is None:
            return []
        new = [one for one in dict.fromkeys(landmarks) if one not in self._known and one not in self._unknown]
        self._unknown += new
        when = timestamp(received.stamp_ns)
        return [
            Output(
                "log",
                Log(
                    timestamp=when,
                    level=LogLevel.WARNING,
                    message=f"{received.topic}: landmark {landmark} is not in the map; its readings are left out",
                    name=self.name,
                ),
            )
            for landmark in new
        ]


def _source(start: Start, maps: Maps, models: Models, key: str) -> PoseSource | None:
    if isinstance(start, KnownStart):
        return None
    try:
        return pose_source(start, grid=maps.grid, models=models)
    except ValueError as error:
        raise ScenarioError(f"{key}.start: {error}") from error


def build(config: LocalizationConfig, context: Context) -> LocalizationEstimator:
    """Return the estimator of a run."""
    sensors = context.beside("sensors")
    scan = getattr(sensors, "scan", None)
    return LocalizationEstimator(
        config=config,
        seed=context.seed,
        landmarks=context.fact("landmarks") or (),
        maps=maps_of(context),
        classes=context.user_classes(),
        scan_range_max=None if scan is None else scan.range_max,
        name=context.name,
    )
