"""Localization in a known map: odometry moves the belief, readings of any sensors correct it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import HostEvent, InitialPose, Odometry, OdometryPose
from dynpf_runtime.node import Output, Received, Result, State, Step
from dynpf_services.estimates import gap_warning, warning
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.schema import key_of

from dynpf.filters.cloud import Cloud
from dynpf.filters.models import Models, Outcome
from dynpf.filters.start import drawn
from dynpf.motion.model import Twist
from dynpf.rng import Stream
from dynpf.types import FloatArray
from dynpf_systems.rooms.localization.beginning import Beginning, doubts_of
from dynpf_systems.rooms.localization.components import Moved, localizer_of, measurements_of, motion_of
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.localization.health import HealthWatch, signs_of
from dynpf_systems.rooms.localization.intake import Intake
from dynpf_systems.rooms.localization.localizers import Found
from dynpf_systems.rooms.localization.odometer import Odometer
from dynpf_systems.rooms.localization.origin import local_origin
from dynpf_systems.rooms.localization.publisher import Publisher
from dynpf_systems.rooms.localization.readings import example_readings
from dynpf_systems.rooms.localization.strides import Strides
from dynpf_systems.rooms.localization.user_components import Classes
from dynpf_systems.rooms.maps import Maps, maps_of

__all__ = ["LocalizationEstimator", "build"]


class LocalizationEstimator:
    """The estimator of a robot in a known map.

    Inputs are processed in the order given. Each first predicts the belief to its own stamp, under the twist in force;
    an input older than the belief counts as if taken now. Readings of the same stamp correct the belief together. The
    start pose holds at the first input's stamp. Raises ScenarioError where the components do not fit each other or the
    run.
    """

    def __init__(
        self,
        *,
        config: LocalizationConfig,
        seed: int,
        landmarks: Sequence[Landmark] = (),
        maps: Maps,
        classes: Classes,
        name: str = "estimator",
    ) -> None:
        """Build the filter from the config, the run's maps and the user's classes by name."""
        self.name = name
        key = key_of(name)
        self._doubts = tuple(doubts_of(config.start, maps.grid))
        self._origin = local_origin(config, maps)
        if self._origin is not None:
            config, maps = self._origin.config(config), self._origin.maps(maps)
        self._seed, self._config, self._maps = seed, config, maps
        motion = motion_of(config, maps, classes, key)
        measurements = measurements_of(config, maps, classes, key)
        self._control = motion.control
        self._models = Models(motion.model, measurements)
        self._localizer = localizer_of(config, motion.model, measurements, maps, classes, key=key)
        self._beginning = Beginning(config.start, maps, self._models, key)
        self._intake = Intake(config, measurements, maps.landmarks, name, self._origin)
        self._odometer = Odometer(config.odometry_delay, self._beginning.pose, self._correct)
        self._strides = None if config.odometry_step is None else Strides(config.odometry_step)
        self._publisher = Publisher(landmarks)
        self._health = HealthWatch(config.health, name)
        self._outcomes = {outcome.value: 0 for outcome in Outcome}
        # Of the step that is being taken; empty between steps.
        self._number = self._draws = 0
        self._found: Found | None = None
        self._logs: list[Output] = []
        self._belief: Any = None  # until there are readings to start from
        self._begin(())

    def step(self, step: Step) -> Result:
        """Process the inputs; return the estimate at the step's stamp, if there were any inputs."""
        if not step.inputs:
            return Result()
        self._number, self._draws, self._found, self._logs = step.number, 0, None, []
        for received in step.inputs:
            self._odometer.advance(received.stamp_ns)
            match received.message:
                case Odometry() | OdometryPose() as odometry:
                    self._take_odometry(received, odometry)
                case InitialPose() as told:
                    self._begin_anew(told if self._origin is None else self._origin.told(told))
                case HostEvent() as gap:
                    self._logs.append(gap_warning(gap, step.stamp_ns, self.name))
            self._logs += self._intake.take(received)
        self._odometer.advance(step.stamp_ns)
        self._correct()
        self._predict()
        return Result((*(self._report() if self._belief is not None else ()), *self._logs))

    def shown(self, most: int) -> FloatArray | None:
        """See Showing: all particles of a cloud, if they are not too many; else some, by weight."""
        match self._belief:
            case None:
                return None
            case Cloud(particles=particles) if particles.shape[1] <= most:
                poses = particles[:3]
            case belief:
                poses = self._localizer.shown(belief, most)
        return np.asarray(poses, dtype=np.float64) if self._origin is None else self._origin.poses(poses)

    def doubts(self) -> Sequence[str]:
        """See Doubting."""
        return self._doubts

    def rehearse(self) -> None:
        """See Rehearsing; a user's measurement model takes part if it gives a reading by ``example()``."""
        stream = Stream.of(self._seed, self.name, 0, "rehearsal")
        poses = self._beginning.rehearsed(stream)  # all equal: then readings expected there pass the gates
        models = self._models.measurements
        readings = list(example_readings(self._config.measurement, models, self._maps, poses[:, 0]))
        self._beginning.rehearse(readings, stream)
        control = self._control(Twist(0.01, 0.01, 0.1))
        self._localizer.rehearse(poses, control, readings, stream)
        drawn(np.zeros(3), np.eye(3), 1, stream)

    def freeze(self) -> State:
        """Return the belief, and the state of odometry, intake, publisher and health."""
        return {
            "belief": None if self._belief is None else self._localizer.freeze(self._belief),
            "odometry": self._odometer.freeze(),
            **({} if self._strides is None else {"strides": self._strides.freeze()}),
            "intake": self._intake.freeze(),
            "published": self._publisher.freeze(),
            "outcomes": dict(self._outcomes),
            "health": self._health.freeze(),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._belief = None if state["belief"] is None else self._localizer.thaw(state["belief"])
        self._odometer.thaw(state["odometry"])
        if self._strides is not None and "strides" in state:
            self._strides.thaw(state["strides"])
        self._intake.thaw(state["intake"])
        self._publisher.thaw(state["published"])
        self._outcomes = dict(state["outcomes"])
        self._health.thaw(state["health"])

    def adopt(self, state: State) -> None:
        """See Adopting: the belief becomes one of ``n`` particles; raises ValueError for that of another model."""
        self.thaw(state)
        if self._belief is not None:
            first = self._localizer.start(np.zeros((3, 1)), self._stream("start"))
            self._belief = self._localizer.adopt(self._belief, first, self._config.n)

    def _take_odometry(self, received: Received, odometry: Odometry | OdometryPose) -> None:
        """Take in odometry; warn of the first, tenth, hundredth and so on that is not believed."""
        before = self._odometer.left_out
        self._odometer.take(received.stamp_ns, odometry)
        count = self._odometer.left_out
        if count > before and str(count).rstrip("0") == "1":
            text = f"{received.topic}: {odometry} is left out, for no robot moves so fast; {count} so far"
            self._logs.append(warning(text, received.stamp_ns, self.name))

    def _begin(self, readings: Sequence[Any]) -> None:
        """Create the initial belief, if the readings suffice."""
        if self._beginning.possible(readings):
            poses = self._beginning.poses(self._config.n, readings, self._stream("start"))
            self._belief = self._localizer.start(poses, self._stream("start"))

    def _begin_anew(self, told: InitialPose) -> None:
        """Forget the belief, and all that it was judged by; the next readings count however little the robot moves."""
        self._intake.pending = []
        self._odometer.release()
        self._odometer.forget_distance()
        if self._strides is not None:
            self._strides.forget()
        mean, covariance = np.array([told.x, told.y, told.theta]), np.array(told.covariance).reshape(3, 3)
        poses = drawn(mean, covariance, self._config.n, self._stream("start"))
        self._belief, self._found = self._localizer.start(poses, self._stream("start")), None
        self._health.begin_anew()

    def _correct(self) -> None:
        """Predict the belief by the motion, and correct it by the pending readings, if there are any."""
        readings, self._intake.pending = self._intake.pending, []
        if not readings:
            return
        if self._belief is None:
            self._begin(readings)
            self._odometer.release()  # the start is made of these readings, and after the movement before
            self._mark()
            return
        if self._health.report is None:
            self._judge(self._localizer.find(self._belief))
        if not self._worthwhile() and not self._localizer.surprised(self._belief_now(), readings):
            return
        motion = self._last_step()
        control = None if motion is None else self._control(motion)
        self._belief, self._found = self._localizer.update(self._belief, control, readings, self._stream("update"))
        self._mark()
        for outcome in self._found.outcomes:
            self._outcomes[outcome.value] += 1
        self._judge(self._found, readings)

    def _predict(self) -> None:
        """Predict the belief by the motion, if the robot moved."""
        motion = self._odometer.release()
        if self._belief is not None:
            self._follow(motion)

    def _follow(self, motion: Sequence[Twist | Moved]) -> None:
        for moved in motion:
            step = moved if self._strides is None else self._strides.take(moved)
            if step is not None:
                self._belief = self._localizer.predict(self._belief, self._control(step), self._stream("predict"))
            self._found = None

    def _last_step(self) -> Twist | Moved | None:
        """Return the last step of the motion up to now, after predicting the belief by those before it."""
        motion = self._odometer.release()
        if self._strides is None:
            self._follow(motion[:-1])
            return motion[-1] if motion else None
        self._follow(motion)
        return self._strides.rest()

    def _mark(self) -> None:
        self._odometer.mark()
        if self._strides is not None:
            self._strides.mark()

    def _worthwhile(self) -> bool:
        """Return whether the robot has moved far enough since the last correction, or there was none."""
        if self._strides is None:
            moved = self._odometer.travelled
        else:
            self._follow(self._odometer.release())
            moved = self._strides.travelled
        return moved is None or moved[0] >= self._config.min_travel or moved[1] >= self._config.min_turn

    def _judge(self, found: Found, readings: Sequence[Any] = ()) -> None:
        """Judge the belief by the result of an update."""
        assert self._odometer.stamp_ns is not None
        signs = signs_of(found, readings, self._localizer.modes(self._belief))
        self._logs += self._health.judge(signs, self._odometer.stamp_ns)

    def _report(self) -> list[Output]:
        stamp_ns = self._odometer.stamp_ns
        assert stamp_ns is not None
        belief = self._belief_now()
        found = self._found or self._localizer.find(belief)
        if self._health.due(stamp_ns):
            self._judge(found)
        health = self._health.report
        assert health is not None
        reckoned = self._odometer.reckoned
        if self._origin is None:
            return self._publisher.messages(
                found, health, reckoned, lambda most: self._localizer.shown(belief, most), stamp_ns
            )
        origin = self._origin
        reckoned = None if reckoned is None else origin.poses(reckoned)
        return self._publisher.messages(
            origin.published(found),
            health,
            reckoned,
            lambda most: origin.poses(self._localizer.shown(belief, most)),
            stamp_ns,
        )

    def _belief_now(self) -> Any:
        """Return the belief after the motion up to now, of which the last is not a step yet."""
        begun = None if self._strides is None else self._strides.begun
        if begun is None:
            return self._belief
        return self._localizer.predict(self._belief, self._control(begun), self._stream("begun"))

    def _stream(self, purpose: str) -> Stream:
        """Return the next stream of this step."""
        self._draws += 1
        return Stream.of(self._seed, self.name, self._number, purpose).part(self._draws)


def build(config: LocalizationConfig, context: Context) -> LocalizationEstimator:
    """Return the estimator of a run."""
    return LocalizationEstimator(
        config=config,
        seed=context.seed,
        landmarks=context.fact("landmarks") or (),
        maps=maps_of(context),
        classes=context.user_classes(),
        name=context.name,
    )
