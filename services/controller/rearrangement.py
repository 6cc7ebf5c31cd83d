"""Controller of the rearrangement task: which part is next, and which law drives the robot.

A subtask is a part: mate with it, move it to its goal, leave it. Subtasks compete by the steepness of next-part's
potential; the choice is made again at events only (a part put down, a stall, a part that moved), with hysteresis, so
that noise cannot make the robot waver. Each tick's step comes from the present estimate; no plan is kept. Clearances
are kept with a margin that grows with the estimate's standard deviation.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynpf.fields.laws import Margins, Pace, leave_step, mate_step, move_step
from dynpf.fields.layout import Layout
from dynpf.fields.placing import blocked_goals, free_place
from dynpf.fields.potentials import log_mate_part, log_move_part, steepest_part
from protocol.messages import Command, Estimate
from services.controller.config import RearrangementControllerConfig
from services.node import Output, Result, State, Step
from services.task import RearrangementTask, layout_of

__all__ = ["RearrangementController"]

FloatArray = NDArray[np.float64]

Mode = Literal["idle", "mate", "move", "leave"]


class RearrangementController:
    """Reads the estimate; commands velocity and gripper and, at the end, that it has finished."""

    name = "controller"
    reads = frozenset({"estimator/state"})
    writes = frozenset({"controller/command"})

    def __init__(
        self,
        *,
        config: RearrangementControllerConfig,
        seed: int,  # noqa: ARG002 - every node is given it
        tick_s: float,
        task: RearrangementTask,
    ) -> None:
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
        count = len(task.parts)
        self._mode: Mode = "idle"
        self._target = -1
        self._parking: FloatArray | None = None  # where a part is put that must make room, in place of its goal
        self._home = np.zeros(count, dtype=bool)
        self._stalls = np.zeros(count, dtype=np.int64)
        self._mode_ticks = 0
        self._best = math.inf  # lowest potential of this stage
        self._best_ticks = 0  # ticks since it was last lowered
        self._home_ticks = 0

    def step(self, step: Step) -> Result:
        estimate = next((item.message for item in reversed(step.inputs) if isinstance(item.message, Estimate)), None)
        command = self._stop() if estimate is None else self._decide(_Scene.of(estimate))
        return Result((Output("controller/command", command),))

    def freeze(self) -> State:
        return {
            "mode": self._mode,
            "target": self._target,
            "parking": self._parking,
            "home": self._home.copy(),
            "stalls": self._stalls.copy(),
            "mode_ticks": self._mode_ticks,
            "best": self._best,
            "best_ticks": self._best_ticks,
            "home_ticks": self._home_ticks,
        }

    def thaw(self, state: State) -> None:
        self._mode, self._target, self._parking = state["mode"], state["target"], state["parking"]
        self._home, self._stalls = state["home"].copy(), state["stalls"].copy()
        self._mode_ticks, self._home_ticks = state["mode_ticks"], state["home_ticks"]
        self._best, self._best_ticks = state["best"], state["best_ticks"]

    # --- events ------------------------------------------------------------------------------------------------

    def _decide(self, scene: "_Scene") -> Command:
        self._update_home(scene)
        self._mode_ticks += 1
        match self._mode:
            case "mate" if scene.held == self._target:
                self._enter("move")
            case "mate" if self._home[self._target] and self._parking is None:
                self._enter("idle")
            case "mate" if self._stalled(log_mate_part(*self._mating(scene))):
                self._stalls[self._target] += 1
                self._enter("idle")
            case "move" if scene.held != self._target:
                self._enter("mate")
            case "move" if self._placed(scene):
                self._enter("leave")
            case "move" if self._stalled(log_move_part(*self._moving(scene))):
                self._stalls[self._target] += 1
                self._enter("leave")
            case "leave" if self._left(scene):
                self._enter("idle")
            case _:
                pass
        if self._mode == "idle":
            self._choose(scene)
        return self._command(scene)

    def _update_home(self, scene: "_Scene") -> None:
        """A part comes home when it is placed, and leaves home only when it is clearly elsewhere."""
        config = self._config
        distance = np.linalg.norm(scene.parts - self._layout.goals, axis=1)
        placed = distance <= config.placed + config.placed_sigmas * scene.sigmas
        kept = distance <= config.reopened + config.reopened_sigmas * scene.sigmas
        home = np.where(self._home, kept, placed) & (np.arange(len(distance)) != scene.held)
        if np.any(home & ~self._home):
            self._stalls[:] = 0
        self._home = home

    def _choose(self, scene: "_Scene") -> None:
        """Pick the part whose descent is steepest among those that are away, have stalled least, and can go home."""
        away = np.flatnonzero(~self._home)
        self._home_ticks = 0 if away.size else self._home_ticks + 1
        self._parking, self._target = None, -1
        if not away.size:
            return
        blocked, blockers = blocked_goals(scene.parts, self._layout, self._config.goal_gap)
        able = away[~blocked[away]]
        if able.size:
            fewest = able[self._stalls[able] == self._stalls[able].min()].tolist()
            self._target = steepest_part(scene.parts, fewest, self._layout, self._config.next_exponent)
        else:
            makes_room = int(np.flatnonzero(blockers & ~self._home)[0])
            self._parking = free_place(scene.parts, makes_room, self._layout, 2.0 * self._layout.robot_radius)
            self._target = makes_room if self._parking is not None else -1
        if self._target >= 0:
            self._enter("mate")

    def _enter(self, mode: Mode) -> None:
        self._mode = mode
        self._mode_ticks = 0
        self._best, self._best_ticks = math.inf, 0

    def _stalled(self, potential: float) -> bool:
        if potential < self._best - self._config.stall_progress:
            self._best, self._best_ticks = potential, 0
        else:
            self._best_ticks += 1
        return self._best_ticks >= self._config.stall_ticks

    def _placed(self, scene: "_Scene") -> bool:
        goal = self._goals().goals[self._target]
        tolerance = self._config.placed + self._config.placed_sigmas * float(scene.sigmas[self._target])
        return math.dist(scene.parts[self._target], goal) <= tolerance

    def _left(self, scene: "_Scene") -> bool:
        sigma = float(self._sigmas_between(scene)[self._target])
        enough = self._config.leave_gap + self._config.leave_sigmas * sigma
        return self._mode_ticks >= self._config.leave_ticks and self._gap(scene) >= enough

    # --- laws --------------------------------------------------------------------------------------------------

    def _command(self, scene: "_Scene") -> Command:
        match self._mode:
            case "mate" if scene.sigmas[self._target] <= self._config.lost_sigma:
                return self._mate(scene)
            case "move":
                return self._move(scene)
            case "leave":
                margins = self._margins(scene)
                x, y = leave_step(scene.pose, scene.parts, self._layout, margins=margins, pace=self._pace)
                return self._velocity(x, y, 0.0, grip=False)
            case _:
                return self._stop()

    def _mate(self, scene: "_Scene") -> Command:
        margins = self._margins(scene)
        margins.parts[self._target] = self._layout.reach
        x, y = mate_step(
            scene.pose[:2],
            scene.parts,
            self._target,
            self._layout,
            margins=margins,
            exponent=self._config.mate_exponent,
            pace=self._pace,
        )
        offset = scene.parts[self._target] - scene.pose[:2]
        aside = math.remainder(math.atan2(offset[1], offset[0]) - scene.pose[2], math.tau)
        most = self._config.max_turn_rate * self._tick_s
        close = self._gap(scene) <= self._config.grip_gap and abs(aside) <= self._config.grip_angle
        return self._velocity(x, y, min(max(aside, -most), most), grip=close)

    def _move(self, scene: "_Scene") -> Command:
        x, y, turn = move_step(
            scene.pose,
            scene.parts,
            self._target,
            self._goals(),
            margins=self._margins(scene),
            exponent=self._config.move_exponent,
            pace=self._pace,
        )
        return self._velocity(x, y, turn, grip=True)

    def _velocity(self, x: float, y: float, turn: float, *, grip: bool) -> Command:
        vx, vy, w = (float(value) / self._tick_s for value in (x, y, turn))
        return Command(mode=self._mode, target=self._target, vx=vx, vy=vy, w=w, grip=grip)

    def _stop(self) -> Command:
        """Stand still, and hold on to what is held."""
        finished = self._home_ticks >= self._config.home_ticks
        return Command(mode=self._mode, target=self._target, grip=self._mode == "move", finished=finished)

    # --- geometry ----------------------------------------------------------------------------------------------

    def _goals(self) -> Layout:
        """Return the layout with the target's goal moved to where it is parked, if it is."""
        if self._parking is None:
            return self._layout
        goals = self._layout.goals.copy()
        goals[self._target] = self._parking
        return self._layout._replace(goals=goals)

    def _mating(self, scene: "_Scene") -> tuple[FloatArray, FloatArray, int, Layout, float]:
        return scene.pose[:2], scene.parts, self._target, self._layout, self._config.mate_exponent

    def _moving(self, scene: "_Scene") -> tuple[FloatArray, FloatArray, int, Layout, float]:
        return scene.pose, scene.parts, self._target, self._goals(), self._config.move_exponent

    def _gap(self, scene: "_Scene") -> float:
        offset = scene.parts[self._target] - scene.pose[:2]
        return math.hypot(*offset) - self._layout.grip_distance(self._target) + self._layout.reach

    def _sigmas_between(self, scene: "_Scene") -> FloatArray:
        both: FloatArray = np.minimum(np.hypot(scene.robot_sigma, scene.sigmas), self._config.max_sigma)
        return both

    def _margins(self, scene: "_Scene") -> Margins:
        config = self._config
        return Margins(
            parts=config.margin + config.margin_sigmas * self._sigmas_between(scene),
            walls=config.margin + config.margin_sigmas * min(scene.robot_sigma, config.max_sigma),
        )


class _Scene:
    """An estimate as arrays: pose (3,), parts (p, 2), standard deviations of each coordinate."""

    def __init__(self, pose: FloatArray, robot_sigma: float, parts: FloatArray, sigmas: FloatArray, held: int) -> None:
        self.pose, self.robot_sigma = pose, robot_sigma
        self.parts, self.sigmas, self.held = parts, sigmas, held

    @classmethod
    def of(cls, estimate: Estimate) -> "_Scene":
        return cls(
            pose=np.array([estimate.x, estimate.y, estimate.theta]),
            robot_sigma=math.sqrt(max(estimate.covariance[0] + estimate.covariance[4], 0.0) / 2.0),
            parts=np.array([(part.x, part.y) for part in estimate.parts]),
            sigmas=np.sqrt(np.array([part.variance for part in estimate.parts])),
            held=estimate.held,
        )
