"""Controller of the rearrangement task: it chooses the next part and the law that drives the robot.

A subtask is a part: mate with it, move it to its goal, leave it. Subtasks are chosen at events only (a part put down, a
stall, a part that moved), with hysteresis, so that noise does not make the robot waver. Each tick's step comes from the
current estimate; no plan is kept. Clearances have a margin that grows with the estimate's standard deviation.
"""

import math
from typing import Literal

import msgspec
import numpy as np
from dynpf_protocol.messages import Command, Estimate
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context

from dynpf.fields.laws import Pace, leave_step
from dynpf.fields.layout import Layout
from dynpf.portable import atan2, dist, norm
from dynpf.types import FloatArray
from dynpf_systems.parts.beliefs import Construction, Motion, Scene, Subtask, margins_of
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.messages import PartsCommand, PartsEstimate
from dynpf_systems.parts.navigation import NavigationConstruction
from dynpf_systems.parts.product import ProductConstruction
from dynpf_systems.parts.task import RearrangementTask, layout_of, task_of

__all__ = ["RearrangementController", "build"]


Mode = Literal["idle", "mate", "move", "leave"]

Decision = tuple[Command, bool]  # the velocity, and whether to grip

ANOTHER_WAY = 0.3  # rise of a potential, in metres, that indicates another path rather than noise of the estimate


class RearrangementController:
    """Reads the estimates of robot and parts; commands velocity and gripper and, at the end, that it has finished.

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
        self._layout = layout_of(task)
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

    def step(self, step: Step) -> Result:
        """Return the commands for the newest estimates; stand still without new ones."""
        scene = self._scene(step)
        command, grip = self._stop() if scene is None else self._decide(scene)
        handling = PartsCommand(mode=self._mode, target=self._target, grip=grip)
        return Result((Output("controller/parts", handling), Output("controller/command", command)))

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
        if parts:
            self._stamp_ns = max(parts)
            self._parts = parts[self._stamp_ns]
        return next((Scene.of(robot, parts[stamp]) for stamp, robot in reversed(robots) if stamp in parts), None)

    def freeze(self) -> State:
        """Return the subtask, the stage, the parts at home, counters and the newest estimate."""
        subtask = self._subtask
        return {
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
            "stamp_ns": self._stamp_ns,
            "parts": None if self._parts is None else msgspec.to_builtins(self._parts),
            "construction": self._construction.freeze(),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._mode = state["mode"]
        self._subtask = None if state["subtask"] is None else Subtask(*state["subtask"])
        self._home, self._stalls = state["home"].copy(), state["stalls"].copy()
        self._mode_ticks, self._home_ticks = state["mode_ticks"], state["home_ticks"]
        self._wait, self._refused = state["wait"], state["refused"]
        self._best, self._best_ticks = state["best"], state["best_ticks"]
        self._stamp_ns = state["stamp_ns"]
        self._parts = None if state["parts"] is None else msgspec.convert(state["parts"], PartsEstimate)
        self._construction.thaw(state["construction"])

    # --- events ------------------------------------------------------------------------------------------------

    def _decide(self, scene: Scene) -> Decision:
        self._update_home(scene)
        self._mode_ticks += 1
        subtask = self._subtask
        if subtask is not None:
            self._react(scene, subtask)
        if self._subtask is None:
            self._choose(scene)
        return self._act(scene)

    def _react(self, scene: Scene, subtask: Subtask) -> None:
        """Change the stage of the subtask, or end it, depending on the scene."""
        match self._mode:
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
        home = np.where(self._home, kept, placed) & (np.arange(len(distance)) != scene.held)
        if np.any(home & ~self._home):
            self._stalls[:] = 0
        self._home = home

    def _choose(self, scene: Scene) -> None:
        away = np.flatnonzero(~self._home)
        self._home_ticks = 0 if away.size else self._home_ticks + 1
        seen = away[scene.sigmas[away] <= self._config.lost_sigma]
        self._wait = max(self._wait - 1, 0)
        if not seen.size or self._wait:
            return
        # No part is moved aside on the evidence of a single tick: the next estimates may show a free path.
        self._subtask = self._construction.choose(scene, seen, self._stalls, make_way=self._refused)
        self._refused = self._subtask is None
        if self._subtask is None:
            self._wait = self._config.choice_ticks
        else:
            # A part that makes way comes after those for which it does.
            self._stalls[self._subtask.part] += self._subtask.parked
            self._enter("mate")

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
