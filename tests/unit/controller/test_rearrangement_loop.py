"""The closed loop without a bus: workspace, noisy detections, estimator, controller. Every part comes home."""

import math

import numpy as np
import pytest

from dynpf.metrics.rearrangement import all_home
from dynpf.rng import generator
from protocol.messages import Detection, Detections, Gripper
from services.controller.config import RearrangementControllerConfig
from services.controller.rearrangement import RearrangementController
from services.estimator.config import RearrangementConfig
from services.estimator.rearrangement import RearrangementEstimator
from services.node import Received, Step
from services.simulator.config import WorkspaceConfig
from services.simulator.workspace import WorkspaceSimulator
from services.task import PartSpec, RearrangementTask

TICK_S, TICK_NS = 0.05, 50_000_000
VARIANCE = 0.2e-4
GOALS = [(0.55 * math.cos(angle), 0.55 * math.sin(angle)) for angle in np.radians([90, 210, 330])]


def run(seed, starts=(None, None, None)):
    """Return the last truth/parts and the number of ticks."""
    task = RearrangementTask(
        parts=tuple(
            PartSpec(radius=radius, goal=goal, start=start)
            for radius, goal, start in zip((0.06, 0.08, 0.11), GOALS, starts, strict=True)
        )
    )
    given = {"seed": seed, "tick_s": TICK_S, "task": task}
    simulator = WorkspaceSimulator(config=WorkspaceConfig(), **given)
    estimator = RearrangementEstimator(config=RearrangementConfig(measurement_variance=VARIANCE), **given)
    controller = RearrangementController(config=RearrangementControllerConfig(), **given)
    command = ()
    for tick in range(2000):
        result = simulator.step(_step(tick, command))
        robot, parts = (output.message for output in result.outputs[:2])
        detections = ("sensors/overhead", _detect(task, robot, parts, generator(seed, "sensors", tick)))
        gripper = ("sensors/gripper", Gripper(contact=parts.held >= 0, theta=robot.theta))
        estimates = estimator.step(_step(tick, (detections, gripper, *command))).outputs
        state = tuple((output.topic, output.message) for output in estimates if output.topic == "estimator/state")
        command = (("controller/command", controller.step(_step(tick, state)).outputs[0].message),)
        if result.finished:
            break
    return parts, tick


def _step(tick, messages):
    stamp = tick * TICK_NS
    return Step(tick, tick, stamp, tuple(Received(topic, "", "", tick, stamp, message) for topic, message in messages))


def _detect(task, robot, parts, random):
    true = [(robot.x, robot.y, task.robot_radius, -60.0), *((p.x, p.y, p.radius, 60.0) for p in parts.parts)]
    noise = math.sqrt(VARIANCE) * random.standard_normal((len(true), 2))
    discs = [
        Detection(x=x + dx, y=y + dy, radius=radius, grey=grey)
        for (x, y, radius, grey), (dx, dy) in zip(true, noise.tolist(), strict=True)
    ]
    return Detections(discs=tuple(discs[index] for index in random.permutation(len(discs))))


def home_and_clean(parts):
    where = np.array([(part.x, part.y) for part in parts.parts])
    return parts.finished and parts.contacts == 0 and all_home(where, np.array(GOALS), 0.02)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_every_part_comes_home_without_a_contact(seed):
    parts, ticks = run(seed)
    assert home_and_clean(parts), parts
    assert ticks < 1200


def test_parts_that_stand_in_each_others_goals_come_home():
    parts, _ = run(3, starts=(GOALS[1], GOALS[2], GOALS[0]))
    assert home_and_clean(parts), parts
