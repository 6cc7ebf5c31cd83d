"""The closed loop without a bus: workspace, noisy detections, estimator, controller. Every part comes home."""

import math

import numpy as np
import pytest
from dynpf_protocol.messages import Message, RobotState
from dynpf_runtime.node import Received, Step
from dynpf_systems.parts.config import Hiding, Intervention, RearrangementConfig, WorkspaceConfig
from dynpf_systems.parts.controller import RearrangementController
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.estimator import RearrangementEstimator
from dynpf_systems.parts.messages import Detection, Detections, Gripper, PartsState
from dynpf_systems.parts.simulator import WorkspaceSimulator
from dynpf_systems.parts.task import PartSpec, RearrangementTask

from dynpf.metrics.rearrangement import all_home
from dynpf.rng import generator

TICK_S, TICK_NS = 0.05, 50_000_000
LOW, HIGH = 0.2e-4, 5.0e-4  # m^2, the least and the most noise of PARTS
READ = ("estimator/parts", "estimator/state")
GOALS = [(0.55 * math.cos(angle), 0.55 * math.sin(angle)) for angle in np.radians([90, 210, 330])]


def run(seed, starts=(None, None, None), variance=LOW, **world):
    """Return the last truth/parts and the number of ticks; ``world``: settings of the workspace."""
    task = RearrangementTask(
        parts=tuple(
            PartSpec(radius=radius, goal=goal, start=start)
            for radius, goal, start in zip((0.06, 0.08, 0.11), GOALS, starts, strict=True)
        )
    )
    given = {"seed": seed, "tick_s": TICK_S, "task": task}
    simulator = WorkspaceSimulator(config=WorkspaceConfig(**world), **given)
    estimator = RearrangementEstimator(config=RearrangementConfig(measurement_variance=variance), **given)
    controller = RearrangementController(config=RearrangementControllerConfig(), tick_s=TICK_S, task=task)
    command: tuple[tuple[str, Message], ...] = ()
    for tick in range(2000):
        result = simulator.step(_step(tick, command))
        robot, parts = (output.message for output in result.outputs[:2])
        assert isinstance(robot, RobotState)
        assert isinstance(parts, PartsState)
        detections = ("sensors/overhead", _detect(task, robot, parts, variance, generator(seed, "sensors", tick)))
        gripper = ("sensors/gripper", Gripper(contact=parts.held >= 0, theta=robot.theta))
        estimates = estimator.step(_step(tick, (detections, gripper, *command))).outputs
        state = tuple((output.topic, output.message) for output in estimates if output.topic in READ)
        command = tuple((output.topic, output.message) for output in controller.step(_step(tick, state)).outputs)
        if result.finished:
            break
    return parts, tick


def _step(tick, messages):
    stamp = tick * TICK_NS
    return Step(tick, tick, stamp, tuple(Received(topic, "", "", tick, stamp, message) for topic, message in messages))


def _detect(task, robot, parts, variance, random):
    seen = [part for index, part in enumerate(parts.parts) if index not in parts.hidden]
    true = [(robot.x, robot.y, task.robot_radius, -60.0), *((p.x, p.y, p.radius, 60.0) for p in seen)]
    noise = math.sqrt(variance) * random.standard_normal((len(true), 2))
    discs = [
        Detection(x=x + dx, y=y + dy, radius=radius, grey=grey)
        for (x, y, radius, grey), (dx, dy) in zip(true, noise.tolist(), strict=True)
    ]
    return Detections(discs=tuple(discs[index] for index in random.permutation(len(discs))))


def home_and_clean(parts, tolerance=0.02):
    where = np.array([(part.x, part.y) for part in parts.parts])
    return parts.finished and parts.contacts == 0 and all_home(where, np.array(GOALS), tolerance)


@pytest.mark.parametrize("seed", [1, 5])
def test_every_part_comes_home_without_a_contact(seed):
    parts, ticks = run(seed)
    assert home_and_clean(parts), parts
    assert ticks < 1200


def test_parts_that_stand_in_each_others_goals_come_home():
    parts, _ = run(3, starts=(GOALS[1], GOALS[2], GOALS[0]))
    assert home_and_clean(parts), parts


AT = ((0.6, 0.5), (-0.6, 0.5), (0.0, -0.7))  # where the parts start when something happens to them


@pytest.fixture(scope="module")
def undisturbed():
    """Return how many ticks it takes when nothing happens."""
    return run(1, AT, HIGH)[1]


@pytest.mark.parametrize(
    "world",
    [
        pytest.param({"slip_probability": 0.6}, id="matings slip"),
        pytest.param({"hidings": tuple(Hiding(tick=10, ticks=90, part=part) for part in (0, 1))}, id="two are hidden"),
        pytest.param(
            {
                "interventions": (
                    Intervention(tick=60, part=0, to=(0.8, 0.8)),
                    Intervention(tick=230, part=2, to=(-0.8, -0.8)),
                )
            },
            id="two are moved by someone",
        ),
    ],
)
def test_whatever_happens_to_the_parts_they_come_home_though_noise_is_high(world, undisturbed):
    parts, ticks = run(1, AT, HIGH, **world)
    assert home_and_clean(parts, 0.05), parts
    assert ticks > undisturbed  # it did happen, and took its time
