"""Controller of the rearrangement task: it chooses the next part and the law that drives the robot.

A subtask is a part: mate with it, move it to its goal, leave it. Subtasks are chosen at events only (a part put down, a
stall, a part that moved), with hysteresis, so that noise does not make the robot waver. Each tick's step comes from the
current estimate; no plan is kept. Clearances have a margin that grows with the estimate's standard deviation.
"""

import math
from typing import Any

import msgspec
import numpy as np
from dynpf_protocol.messages import Command, Estimate, Log, LogLevel, timestamp
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context
from numpy.typing import NDArray

from dynpf.fields.clearance import disc_clearances
from dynpf.fields.laws import Pace, leave_step
from dynpf.fields.layout import Layout
from dynpf.portable import atan2, dist, norm
from dynpf.types import FloatArray
from dynpf_systems.parts.beliefs import Construction, Motion, Scene, Subtask, margins_of
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.goals import shared_out
from dynpf_systems.parts.looking import Look
from dynpf_systems.parts.messages import Gripper, Identities, Mode, PartsCommand, PartsEstimate
from dynpf_systems.parts.navigation import NavigationConstruction
from dynpf_systems.parts.product import ProductConstruction
from dynpf_systems.parts.task import RearrangementTask, layout_of, task_of

__all__ = ["RearrangementController", "build"]


Decision = tuple[Command, bool]  # the velocity, and whether to grip

UNDECIDED = (
    "not finished: parts {parts} look alike and which is which is not known; declare them interchangeable "
    "(task.interchangeable), or give their starts or radii that differ"
)

ANOTHER_WAY = 0.3  # rise of a potential, in metres, that indicates another path rather than noise of the estimate


class RearrangementController:
    """Reads the estimates of robot and parts and the gripper's switch; commands velocity and gripper, and says the end.

    It decides by estimates of the same stamp. Those of the parts are sent first and trigger no step; where many arrive
    at once, those of the parts may come a step before the robot's.
    """

    def __init__(
        self,
        *,
        config: RearrangementControllerConfig,
        tick_s: float,
        task: RearrangementTask,
        name: str = "controller",
    ) -> None:
        self.name = name
        self._task, self._layout = task, layout_of(task)
        self._config = config
        self._tick_s = tick_s
        self._pace = Pace(
            longest=config.max_speed * tick_s,
            slow_distance=config.slow_distance,
            max_turn=config.max_carrying_turn_rate * tick_s,
            arm=config.swing_arm,
            rate=config.clearance_rate,
        )
        self._construction = _construct(config, self._layout, self._pace)
        count = len(task.parts)
        self._mode: Mode = "idle"
        self._subtask: Subtask | None = None
        self._home = np.zeros(count, dtype=bool)
        self._stalls = np.zeros(count, dtype=np.int64)
        self._mode_ticks = 0
        self._best = math.inf  # lowest potential of this stage
        self._best_ticks = 0  # ticks since it was last lowered
        self._home_ticks = 0
        self._wait = 0  # ticks until the next choice of a subtask ...
        self._refused = False  # ... after a choice without a result
        self._stamp_ns = -1  # of the newest estimate of the parts ...
        self._parts: PartsEstimate | None = None  # ... and that estimate
        self._contact = False  # the gripper's switch
        self._identities: Identities | None = None  # the newest; None where nothing looks alike
        self._goals = np.arange(count)  # of the parts, which interchangeable ones share out among them
        self._look = Look()
        self._doubt_ticks = 0  # with nothing left to do but parts of doubtful identity

    def step(self, step: Step) -> Result:
        """Return the commands for the newest estimates; stand still without new ones."""
        scene, before = self._scene(step), self._mode
        command, grip = self._stop() if scene is None else self._decide(scene)
        handling = PartsCommand(mode=self._mode, target=self._target, grip=grip)
        said = self._said(scene, step) if scene is not None and self._mode != before else ()
        return Result((*said, Output("controller/parts", handling), Output("controller/command", command)))

    def _scene(self, step: Step) -> Scene | None:
        """Return the newest estimates of robot and parts with the same stamp, None without new ones."""
        robots = [
            (received.stamp_ns, received.message) for received in step.inputs if isinstance(received.message, Estimate)
        ]
        parts = {} if self._parts is None else {self._stamp_ns: self._parts}
        parts |= {
            received.stamp_ns: received.message
            for received in step.inputs
            if isinstance(received.message, PartsEstimate)
        }
        for received in step.inputs:
            match received.message:
                case Identities():
                    self._identities = received.message
                case Gripper():
                    self._contact = received.message.contact
                case _:
                    pass
        if parts:
            self._stamp_ns = max(parts)
            self._parts = parts[self._stamp_ns]
        return next(
            (Scene.of(robot, parts[stamp], self._identities) for stamp, robot in reversed(robots) if stamp in parts),
            None,
        )

    def _said(self, scene: Scene, step: Step) -> tuple[Output, ...]:
        """Return what is to be told of a new mode."""
        match self._mode:
            case "look":
                level, message = LogLevel.INFO, "not sure which disc is the robot; it moves a little to find out"
            case "undecided":
                parts = ", ".join(str(part) for part in np.flatnonzero(~self._sure(scene)).tolist())
                level, message = LogLevel.WARNING, UNDECIDED.format(parts=parts)
            case _:
                return ()
        return (Output("log", Log(timestamp=timestamp(step.stamp_ns), level=level, message=message, name=self.name)),)

    def freeze(self) -> State:
        """Return the subtask, the stage, the parts at home, counters and the newest estimate."""
        subtask = self._subtask
        state: dict[str, Any] = {
            "mode": self._mode,
            "subtask": None if subtask is None else list(subtask),
            "home": self._home.copy(),
            "stalls": self._stalls.copy(),
            "mode_ticks": self._mode_ticks,
            "best": self._best,
            "best_ticks": self._best_ticks,
            "home_ticks": self._home_ticks,
            "wait": self._wait,
            "refused": self._refused,
            "contact": self._contact,
            "stamp_ns": self._stamp_ns,
            "parts": None if self._parts is None else msgspec.to_builtins(self._parts),
            "construction": self._construction.freeze(),
        }
        if self._task.interchangeable:
            state["goals"] = self._goals.copy()
        if self._identities is not None:
            state["identities"] = msgspec.to_builtins(self._identities)
            state["look"], state["doubt_ticks"] = list(self._look), self._doubt_ticks
        return state

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._mode = state["mode"]
        self._subtask = None if state["subtask"] is None else Subtask(*state["subtask"])
        self._home, self._stalls = state["home"].copy(), state["stalls"].copy()
        self._mode_ticks, self._home_ticks = state["mode_ticks"], state["home_ticks"]
        self._wait, self._refused, self._contact = state["wait"], state["refused"], state["contact"]
        self._best, self._best_ticks = state["best"], state["best_ticks"]
        self._stamp_ns = state["stamp_ns"]
        self._parts = None if state["parts"] is None else msgspec.convert(state["parts"], PartsEstimate)
        self._take_goals(state.get("goals", self._goals))
        self._construction.thaw(state["construction"])
        if "identities" in state:
            self._identities = msgspec.convert(state["identities"], Identities)
            self._look, self._doubt_ticks = Look(*state["look"]), state["doubt_ticks"]

    # --- events ------------------------------------------------------------------------------------------------

    def _decide(self, scene: Scene) -> Decision:
        self._update_home(scene)
        self._mode_ticks += 1
        if self._mode == "undecided":
            return self._stop()
        if scene.identities[0] < self._config.sure:
            return self._find_robot(scene)
        if self._mode == "look":
            self._enter("idle")
        subtask = self._subtask
        if subtask is not None:
            self._react(scene, subtask)
        if self._subtask is None:
            self._choose(scene)
        return self._act(scene)

    def _react(self, scene: Scene, subtask: Subtask) -> None:
        """Change the stage of the subtask, or end it, depending on the scene."""
        match self._mode:
            case "mate" if not (subtask.parked or self._sure(scene)[subtask.part]):
                self._end()
            case "mate" if scene.held == subtask.part:
                self._enter("move")
            case "mate" if self._home[subtask.part] and not subtask.parked:
                self._end()
            case "move" if scene.held != subtask.part:
                self._enter("mate")
            case "move" if self._placed(scene, subtask):
                self._enter("leave")
            case "leave" if self._left(scene, subtask):
                self._end()
            case _ if self._best_ticks >= self._config.stall_ticks:
                self._give_up(subtask)
            case _:
                pass

    def _update_home(self, scene: Scene) -> None:
        """Update which parts are home: a part enters when it is placed, and leaves when it is clearly elsewhere."""
        config = self._config
        distance = norm(scene.parts - self._layout.goals, axis=1)
        placed = distance <= config.placed + config.placed_sigmas * scene.sigmas
        placed &= scene.sigmas <= config.lost_sigma
        kept = distance <= config.reopened + config.reopened_sigmas * scene.sigmas
        home = np.where(self._home, kept, placed) & (np.arange(len(distance)) != scene.held) & self._sure(scene)
        if np.any(home & ~self._home):
            self._stalls[:] = 0
        self._home = home

    def _choose(self, scene: Scene) -> None:
        away = np.flatnonzero(~self._home)
        self._home_ticks = 0 if away.size else self._home_ticks + 1
        sure = self._sure(scene)
        self._doubt_ticks = 0 if sure.all() else self._doubt_ticks + 1
        if self._doubt_ticks > self._config.doubt_ticks:
            self._enter("undecided")
            return
        seen = away[(scene.sigmas[away] <= self._config.lost_sigma) & sure[away]]
        self._wait = max(self._wait - 1, 0)
        if not seen.size or self._wait:
            return
        self._share_out(scene)
        # No part is moved aside on the evidence of a single tick: the next estimates may show a free path.
        self._subtask = self._construction.choose(scene, seen, self._stalls, make_way=self._refused)
        self._refused = self._subtask is None
        if self._subtask is None:
            self._wait = self._config.choice_ticks
        else:
            self._doubt_ticks = 0
            # A part that makes way comes after those for which it does.
            self._stalls[self._subtask.part] += self._subtask.parked
            self._enter("mate")

    def _sure(self, scene: Scene) -> NDArray[np.bool_]:
        return np.asarray(scene.identities[1:] >= self._config.sure)

    def _share_out(self, scene: Scene) -> None:
        """Let the interchangeable parts that are not home share out the goals that they have."""
        kinds = np.where(self._home, -1 - np.arange(len(self._home)), self._task.kinds)
        goals = self._goals[shared_out(scene.parts, self._layout.goals, kinds)]
        if np.any(goals != self._goals):
            self._take_goals(goals)

    def _take_goals(self, goals: NDArray[np.intp]) -> None:
        self._goals = goals.copy()
        self._layout = self._layout._replace(goals=layout_of(self._task).goals[goals])
        self._construction = _construct(self._config, self._layout, self._pace)

    def _enter(self, mode: Mode) -> None:
        self._mode = mode
        self._mode_ticks = 0
        self._best, self._best_ticks = math.inf, 0

    def _end(self) -> None:
        self._subtask = None
        self._enter("idle")

    def _give_up(self, subtask: Subtask) -> None:
        """Put down the held part, and give priority to the others."""
        if self._mode == "move":
            self._stalls[subtask.part] += 1
            self._enter("leave")
        else:
            self._stalls[subtask.part] += self._mode == "mate"
            self._end()

    def _watch(self, motion: Motion) -> None:
        """Count the ticks without progress; the count restarts where a potential solved again has changed the path."""
        another = motion.renewed and motion.potential > self._best + ANOTHER_WAY
        if another or motion.potential < self._best - self._construction.progress:
            self._best, self._best_ticks = motion.potential, 0
        else:
            self._best_ticks += 1

    def _placed(self, scene: Scene, subtask: Subtask) -> bool:
        tolerance = self._config.placed + self._config.placed_sigmas * float(scene.sigmas[subtask.part])
        return dist(scene.parts[subtask.part], subtask.goal) <= tolerance

    def _left(self, scene: Scene, subtask: Subtask) -> bool:
        sigma = float(scene.sigmas_between(self._config.max_sigma)[subtask.part])
        enough = self._config.leave_gap + self._config.leave_sigmas * sigma
        return self._mode_ticks >= self._config.leave_ticks and self._gap(scene, subtask) >= enough

    def _find_robot(self, scene: Scene) -> Decision:
        """Move a little and wait, again and again, until it shows which disc moves as commanded."""
        if self._mode == "move":
            return self._stop()
        if self._mode != "look":
            self._end()
            self._enter("look")
        self._look = self._look.next(scene, self._layout, self._config, self._pace.longest)
        return self._velocity(self._look.step(self._config), grip=False)

    # --- laws --------------------------------------------------------------------------------------------------

    def _act(self, scene: Scene) -> Decision:
        subtask = self._subtask
        match self._mode:
            case "mate" if subtask is not None:
                return self._mate(scene, subtask)
            case "move" if subtask is not None:
                motion = self._construction.move(scene, subtask)
                return self._follow(motion, grip=True)
            case "leave" if subtask is not None:
                margins = margins_of(scene, self._config)
                step = leave_step(scene.pose, scene.parts, self._layout, margins=margins, pace=self._pace)
                self._best_ticks += 1
                return self._velocity(np.append(step, 0.0), grip=False)
            case _:
                return self._stop()

    def _mate(self, scene: Scene, subtask: Subtask) -> Decision:
        """Approach the part with the gripper turned to it; close the jaws when it is close and ahead."""
        lost = scene.sigmas[subtask.part] > self._config.lost_sigma
        motion = None if lost else self._construction.mate(scene, subtask)
        if motion is None:
            self._best_ticks += 1
            return self._stop()
        offset = scene.parts[subtask.part] - scene.pose[:2]
        aside = math.remainder(atan2(float(offset[1]), float(offset[0])) - scene.pose[2], math.tau)
        most = self._config.max_turn_rate * self._tick_s
        turn = np.array([0.0, 0.0, min(max(aside, -most), most)])
        config = self._config
        doubt = config.grip_sigmas * float(scene.sigmas_between(config.max_sigma)[subtask.part])
        near = config.grip_slack + max(self._layout.reach, doubt)
        if self._contact and self._nearest(scene) == subtask.part:
            near += doubt  # the switch knows better than estimates that it is time
        blur = config.blur_sigmas * scene.bearing_sigma(subtask.part, config.max_sigma)
        close = self._gap(scene, subtask) <= near and abs(aside) <= config.grip_angle + blur
        return self._follow(motion._replace(step=motion.step + turn), grip=close)

    def _follow(self, motion: Motion, *, grip: bool) -> Decision:
        self._watch(motion)
        return self._velocity(motion.step, grip=grip)

    def _velocity(self, step: FloatArray, *, grip: bool) -> Decision:
        vx, vy, w = (step / self._tick_s).tolist()
        return Command(vx=vx, vy=vy, w=w), grip

    def _stop(self) -> Decision:
        """Stand still, and keep holding a held part."""
        finished = self._home_ticks >= self._config.home_ticks
        return Command(finished=finished), self._mode == "move"

    @property
    def _target(self) -> int:
        return -1 if self._subtask is None else self._subtask.part

    def _nearest(self, scene: Scene) -> int:
        robot = scene.pose[:2], self._layout.robot_radius
        return int(disc_clearances(*robot, scene.parts, self._layout.radii).argmin())

    def _gap(self, scene: Scene, subtask: Subtask) -> float:
        offset = scene.parts[subtask.part] - scene.pose[:2]
        return float(norm(offset)) - self._layout.grip_distance(subtask.part) + self._layout.reach


def _construct(config: RearrangementControllerConfig, layout: Layout, pace: Pace) -> Construction:
    if config.construction == "product":
        return ProductConstruction(config, layout, pace)
    return NavigationConstruction(config, layout, pace)


def build(config: RearrangementControllerConfig, context: Context) -> RearrangementController:
    """Return the controller of a run."""
    return RearrangementController(config=config, tick_s=context.tick_s, task=task_of(context), name=context.name)
