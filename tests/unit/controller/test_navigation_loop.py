"""The navigation construction in closed loop with the workspace: whatever happens, every part comes home."""

import math

import numpy as np
import pytest
from dynpf_protocol.messages import Estimate, Message, RobotState
from dynpf_runtime.node import Received, Step, state_digest
from dynpf_systems.parts.config import WorkspaceConfig
from dynpf_systems.parts.controller import RearrangementController
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.messages import PartEstimate, PartsEstimate, PartsState
from dynpf_systems.parts.simulator import WorkspaceSimulator
from dynpf_systems.parts.task import PartSpec, RearrangementTask

from dynpf.metrics.rearrangement import all_home, normalized_part_length
from dynpf.rng import generator

TICK_NS = 50_000_000
RADII = (0.06, 0.10, 0.08, 0.11, 0.07, 0.09)


class Loop:
    """Simulator and controller; the estimates are the truth with standard deviation ``sigma``."""

    def __init__(self, task, seed=1, sigma=0.0):
        given = {"seed": seed, "tick_s": 0.05, "task": task}
        self.task, self.seed, self.sigma = task, seed, sigma
        self.simulator = WorkspaceSimulator(config=WorkspaceConfig(process_variance=0.0), **given)
        self.controller = RearrangementController(config=RearrangementControllerConfig(), tick_s=0.05, task=task)
        self.lost = ()
        self.tick, self.commands, self.path, self.finished = 0, [], [], False
        self.inputs: tuple[tuple[str, Message], ...] = ()

    def run(self, ticks=3000, until=None):
        for _ in range(ticks):
            result = self.simulator.step(self._step(self.inputs))
            robot, parts = (output.message for output in result.outputs[:2])
            assert isinstance(robot, RobotState)
            assert isinstance(parts, PartsState)
            self.robot, self.parts = robot, parts
            self.path.append(self.where())
            self.finished = result.finished
            if self.finished:
                break
            self.estimates = self._estimates()
            outputs = self.controller.step(self._step(self.estimates)).outputs
            self.inputs = tuple((output.topic, output.message) for output in outputs)
            self.commands.append(outputs[0].message)
            self.tick += 1
            if until is not None and until(self):
                break
        return self

    def change(self, **changes):
        """Meddle with the simulated world."""
        self.simulator.thaw({**self.simulator.freeze(), **changes})

    def where(self):
        return np.array([(part.x, part.y) for part in self.parts.parts])

    def home(self):
        goals = np.array([part.goal for part in self.task.parts])
        return self.finished and self.parts.contacts == 0 and all_home(self.where(), goals, 0.005 + 3.0 * self.sigma)

    def _step(self, messages):
        received = (Received(topic, "", "", self.tick, self.tick * TICK_NS, message) for topic, message in messages)
        return Step(self.tick, self.tick, self.tick * TICK_NS, tuple(received))

    def _estimates(self):
        random = generator(self.seed, "test", self.tick)
        robot = np.array([self.robot.x, self.robot.y]) + self.sigma * random.standard_normal(2)
        parts = []
        for index, (x, y) in enumerate(
            self.where() + self.sigma * random.standard_normal((len(RADII), 2))[: self.count]
        ):
            if index in self.lost:
                old = self.estimates[0][1].parts[index]
                parts.append(PartEstimate(x=old.x, y=old.y, variance=1.0, seen=False))
            else:
                parts.append(PartEstimate(x=float(x), y=float(y), variance=self.sigma**2, seen=True))
        variance = self.sigma**2
        estimate = Estimate(
            x=float(robot[0]),
            y=float(robot[1]),
            theta=self.robot.theta,
            covariance=(variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0),
            n_eff=1.0,
        )
        beside = PartsEstimate(parts=tuple(parts), held=self.parts.held)
        return ("estimator/parts", beside), ("estimator/state", estimate)

    @property
    def count(self):
        return len(self.task.parts)


def ring(radius, count, first=90.0):
    angles = np.radians(first + 360.0 / count * np.arange(count))
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


def task_of(goals, starts=None, radii=RADII, **more):
    starts = starts or [None] * len(goals)
    specs = zip(radii, goals, starts, strict=False)
    return RearrangementTask(parts=tuple(PartSpec(radius=r, goal=g, start=s) for r, g, s in specs), **more)


HARD = [(-0.215, 0.1075), (-0.01, 0.1075), (0.215, 0.1075), (-0.215, -0.1075), (0.01, -0.1075), (0.215, -0.1075)]
THREE = ring(0.3, 3)
RING = ring(0.27, 5)


def gripped(loop):
    return loop.parts.held >= 0 and loop.commands[-1].mode == "move"


def test_six_parts_come_home_to_goals_of_4_cm_gaps():
    assert Loop(task_of(HARD), seed=2).run().home()


def test_noise_in_the_estimates_is_no_collision():
    assert Loop(task_of(THREE), seed=3, sigma=0.004).run().home()


@pytest.mark.parametrize(
    ("goals", "starts", "radii"),
    [
        pytest.param(HARD[:2], [HARD[1], HARD[0]], RADII, id="a swap"),
        pytest.param([(0.0, 0.0), *RING], [(0.5, 0.5), *RING], (0.09, *[0.10] * 5), id="a goal ringed by others"),
        pytest.param([(0.5, 0.5), *RING], [(0.0, 0.0), *RING], (0.09, *[0.10] * 5), id="walled in by others"),
        pytest.param([(0.92, 0.92), (-0.89, 0.0)], [(0.0, 0.0), (0.89, 0.0)], RADII, id="goals by the walls"),
    ],
)
def test_whoever_is_in_the_way_makes_way(goals, starts, radii):
    loop = Loop(task_of(goals, starts, radii)).run()
    assert loop.home()
    assert normalized_part_length(np.array(loop.path), np.array(goals)) <= 2.0


def test_of_two_that_swap_one_goes_around_the_other():
    """Its legs to the place in between and home are no shorter than both radii: it had to let the other one by."""
    loop = Loop(task_of(HARD[:2], HARD[1::-1])).run()
    apart, radii = math.dist(*HARD[:2]), RADII[0] + RADII[1]
    assert normalized_part_length(np.array(loop.path), np.array(HARD[:2])) > (1.0 + 2.0 * radii / apart) / 2.0


def test_a_part_pulled_out_of_the_gripper_is_taken_again():
    loop = Loop(task_of(THREE)).run(until=gripped).run(20)
    held = loop.parts.held
    ahead = [math.cos(loop.robot.theta), math.sin(loop.robot.theta)]
    loop.change(held=-1, parts=loop.where() + 0.06 * np.eye(3)[:, [held]] * ahead)
    loop.run(2)
    assert loop.commands[-1].mode == "mate"
    assert loop.run().home()


def test_parts_moved_by_someone_else_are_brought_back():
    """One that was home, and the one that the robot is on its way to."""
    loop = Loop(task_of(THREE)).run(until=lambda loop: [c.mode for c in loop.commands].count("leave") > 5)
    parts = loop.where()
    parts[loop.commands[-1].target] = (-0.8, 0.8)
    loop.change(parts=parts)
    loop.run(until=lambda loop: loop.commands[-1].mode == "mate").run(10)
    parts = loop.where()
    parts[loop.commands[-1].target] += (0.08, 0.0)
    loop.change(parts=parts)
    assert loop.run().home()


def test_a_part_lost_from_view_is_waited_for_and_the_others_come_first():
    loop = Loop(task_of(THREE)).run(until=lambda loop: loop.commands[-1].mode == "mate").run(3)
    first = loop.commands[-1].target
    loop.lost = (first,)
    loop.run(200)
    assert {command.target for command in loop.commands[-100:]} - {first, -1}
    assert not loop.finished
    loop.lost = ()
    assert loop.run().home()


def test_a_thawed_controller_continues_exactly_in_every_stage():
    """Its potentials are made anew from what they were solved for, not from the present estimate."""
    task = task_of(THREE)
    loop, stages = Loop(task, sigma=0.003), set()
    for _ in range(12):
        loop.run(25)
        fresh = RearrangementController(config=RearrangementControllerConfig(), tick_s=0.05, task=task)
        fresh.thaw(loop.controller.freeze())
        assert state_digest(fresh.freeze()) == state_digest(loop.controller.freeze())
        stages.add(loop.commands[-1].mode)
        loop.controller, old = fresh, loop.controller
        loop.run(1)
        outputs = old.step(loop._step(loop.estimates)).outputs
        assert tuple((output.topic, output.message) for output in outputs) == loop.inputs
    assert {"mate", "move"} <= stages


def test_without_anything_to_do_it_finishes():
    goals = [(0.5, 0.5), (-0.5, 0.5)]
    loop = Loop(task_of(goals, goals, robot_start=(0.0, -0.5))).run()
    assert loop.home()
    assert loop.tick < 15
