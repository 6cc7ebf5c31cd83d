"""The controller's events: what is next, gripping, putting down, leaving, stalling, finishing."""

import math
from typing import Literal, NamedTuple

import msgspec
import numpy as np
import pytest
from dynpf_protocol.messages import Estimate
from dynpf_runtime.node import Received, Step, state_digest
from dynpf_systems.parts.controller import RearrangementController
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.messages import Gripper, Identities, PartEstimate, PartsEstimate
from dynpf_systems.parts.task import PartSpec, RearrangementTask

GOALS = ((0.0, 0.55), (-0.476, -0.275), (0.476, -0.275))
RADII = (0.06, 0.08, 0.11)
TASK = RearrangementTask(parts=tuple(PartSpec(radius=r, goal=g) for r, g in zip(RADII, GOALS, strict=True)))
TOPICS: dict[type, str] = {
    Estimate: "estimator/state",
    PartsEstimate: "estimator/parts",
    Identities: "estimator/identities",
    Gripper: "sensors/gripper",
}
AWAY = ((0.5, 0.4), (-0.3, 0.6), (-0.1, -0.6))


@pytest.fixture(autouse=True, params=["navigation", "product"])
def construction(request):
    """Everything here is asked of both constructions."""
    Bench.construction = request.param


class Commanded(NamedTuple):
    """The commands to robot and gripper of one step."""

    mode: str
    target: int
    grip: bool
    vx: float
    vy: float
    w: float
    finished: bool

    @classmethod
    def of(cls, result):
        assert [output.topic for output in result.outputs if output.topic != "log"] == [
            "controller/parts",
            "controller/command",
        ]
        parts, robot = (output.message for output in result.outputs[-2:])
        return cls(parts.mode, parts.target, parts.grip, robot.vx, robot.vy, robot.w, robot.finished)


class Bench:
    """A controller fed with estimates; standard deviation ``sigma`` of everything."""

    construction: Literal["navigation", "product"]

    def __init__(self, task=TASK, **config):
        whole = RearrangementControllerConfig(construction=self.construction, **config)
        self.node = RearrangementController(config=whole, tick_s=0.05, task=task)
        self.tick = 0

    def decide(self, robot=(0.0, 0.0), theta=0.0, parts=AWAY, held=-1, sigma=0.001, *, contact=False, identities=None):
        covariance = tuple(np.diag([sigma**2, sigma**2, 0.0]).ravel().tolist())
        estimate = Estimate(
            x=robot[0],
            y=robot[1],
            theta=theta,
            covariance=covariance,
            n_eff=100.0,
        )
        found = tuple(PartEstimate(x=x, y=y, variance=sigma**2, seen=True) for x, y in parts)
        beside = () if identities is None else (self.told(identities),)
        beside = (self.told(Gripper(contact=contact, theta=theta)), *beside)
        return self.step(*beside, self.told(PartsEstimate(parts=found, held=held)), self.told(estimate))

    def told(self, message, tick=None):
        """Return an estimate as it comes, by default of the tick to come."""
        tick = self.tick if tick is None else tick
        topic = TOPICS[type(message)]
        return Received(topic, "estimator", "boot", tick, tick * 50_000_000, message)

    def step(self, *inputs):
        result = self.node.step(Step(self.tick, self.tick, self.tick * 50_000_000, inputs))
        self.tick += 1
        return Commanded.of(result)


def holding(robot, theta, part):
    """Parts as in AWAY, but ``part`` in the gripper."""
    distance = 0.1 + RADII[part] + 0.01
    parts = list(AWAY)
    parts[part] = (robot[0] + distance * math.cos(theta), robot[1] + distance * math.sin(theta))
    return tuple(parts)


def robot_that_holds_at(place, theta, part):
    distance = 0.1 + RADII[part] + 0.01
    return (place[0] - distance * math.cos(theta), place[1] - distance * math.sin(theta))


def test_drives_towards_the_part_that_is_next_and_turns_its_gripper_to_it():
    command = Bench().decide()
    assert command.mode == "mate"
    target = AWAY[command.target]
    assert command.vx * target[0] + command.vy * target[1] > 0
    assert command.w * math.atan2(target[1], target[0]) > 0
    assert math.hypot(command.vx, command.vy) == pytest.approx(0.2)
    assert not command.grip


def test_noise_does_not_change_the_target():
    bench = Bench()
    first = bench.decide().target
    for shift in (0.02, -0.02, 0.01):
        assert bench.decide(parts=tuple((x + shift, y - shift) for x, y in AWAY)).target == first


def test_closes_the_gripper_only_close_and_aligned():
    bench = Bench()
    target = bench.decide().target
    x, y = AWAY[target]
    for gap, aside, expected in ((0.10, 0.0, False), (0.03, 0.0, False), (0.012, 0.5, False), (0.012, 0.0, True)):
        robot = (x - 0.1 - RADII[target] - gap, y)
        command = bench.decide(robot=robot, theta=aside)
        assert (command.mode, command.grip) == ("mate", expected)


def test_carries_what_it_holds_to_its_goal_and_puts_it_down_there():
    bench = Bench()
    part = bench.decide().target
    robot = (0.0, 0.0)
    command = bench.decide(robot=robot, parts=holding(robot, 0.0, part), held=part)
    assert (command.mode, command.target, command.grip) == ("move", part, True)
    theta = math.atan2(GOALS[part][1], GOALS[part][0])
    there = robot_that_holds_at(GOALS[part], theta, part)
    command = bench.decide(robot=there, theta=theta, parts=holding(there, theta, part), held=part)
    assert (command.mode, command.grip) == ("leave", False)
    assert command.vx * math.cos(theta) + command.vy * math.sin(theta) < -0.15


def test_leaves_backwards_until_there_is_room_then_takes_another():
    bench = Bench()
    part = bench.decide().target
    theta = math.atan2(GOALS[part][1], GOALS[part][0])
    there = robot_that_holds_at(GOALS[part], theta, part)
    parts = holding(there, theta, part)
    bench.decide(robot=there, theta=theta, parts=parts, held=part)
    bench.decide(robot=there, theta=theta, parts=parts, held=part)
    modes = [bench.decide(robot=there, theta=theta, parts=parts).mode for _ in range(5)]
    assert modes == ["leave"] * 5
    back = (there[0] - 0.05 * math.cos(theta), there[1] - 0.05 * math.sin(theta))
    command = bench.decide(robot=back, theta=theta, parts=parts)
    assert command.mode == "mate"
    assert command.target != part


def test_a_lost_grip_is_taken_again():
    bench = Bench()
    part = bench.decide().target
    robot = (0.0, 0.0)
    assert bench.decide(robot=robot, parts=holding(robot, 0.0, part), held=part).mode == "move"
    command = bench.decide(robot=robot, parts=holding(robot, 0.0, part))
    assert (command.mode, command.target) == ("mate", part)


def test_a_part_stays_home_through_noise_but_not_through_a_push():
    bench = Bench(home_ticks=1000)
    assert bench.decide(parts=GOALS).mode == "idle"
    nudged = (*GOALS[:2], (GOALS[2][0] + 0.010, GOALS[2][1]))
    assert bench.decide(parts=nudged).mode == "idle"
    pushed = (*GOALS[:2], (GOALS[2][0] + 0.020, GOALS[2][1]))
    command = bench.decide(parts=pushed)
    assert (command.mode, command.target) == ("mate", 2)


def test_finishes_after_some_ticks_with_all_parts_home():
    bench = Bench(home_ticks=3)
    finished = [bench.decide(parts=GOALS).finished for _ in range(4)]
    assert finished == [False, False, True, True]
    assert not bench.decide(parts=(*GOALS[:2], AWAY[2])).finished


def test_a_part_that_cannot_be_reached_gives_way_to_another():
    bench = Bench(stall_ticks=5)
    first = bench.decide().target
    targets = [bench.decide().target for _ in range(8)]
    assert targets[0] == first
    assert targets[-1] != first


def test_a_part_whose_goal_is_taken_waits():
    """Part 2 stands where part 1 belongs: whatever is steepest, 2 goes first of the two."""
    parts = (GOALS[0], (0.5, 0.8), GOALS[1])
    assert Bench().decide(robot=(0.0, 0.0), parts=parts).target == 2


def test_of_two_that_swap_goals_one_makes_room():
    task = RearrangementTask(parts=TASK.parts[1:])
    bench = Bench(task=task)
    swapped = (GOALS[2], GOALS[1])
    modes = [bench.decide(parts=swapped).mode for _ in range(11)]
    assert modes == ["idle"] * 10 + ["mate"]
    # In the gripper it is not carried to its goal, where the other one stands.
    part = bench.decide(parts=swapped).target
    held = list(swapped)
    held[part] = (0.1 + RADII[part + 1] + 0.01, 0.0)
    command = bench.decide(robot=(0.0, 0.0), parts=held, held=part)
    towards_goal = np.array(GOALS[part + 1]) - held[part]
    assert command.mode == "move"
    assert np.array([command.vx, command.vy]) @ towards_goal / np.linalg.norm(towards_goal) < 0.15


def test_margins_grow_with_uncertainty():
    """Beside a wall the robot may go on when it knows where it is, and must back off when it does not."""
    parts = ((0.5, 0.9), (-0.5, -0.6), (0.5, -0.6))
    where = (-0.885, 0.0)
    assert Bench().decide(robot=where, parts=parts, sigma=0.0001).vx > -0.2
    sure, unsure = (Bench().decide(robot=where, parts=parts, sigma=sigma).vx for sigma in (0.0001, 0.02))
    assert unsure > sure


def test_without_an_estimate_it_stands_and_holds_on():
    bench = Bench()
    part = bench.decide().target
    robot = (0.0, 0.0)
    bench.decide(robot=robot, parts=holding(robot, 0.0, part), held=part)
    command = bench.step()
    assert (command.vx, command.vy, command.w, command.grip) == (0.0, 0.0, 0.0, True)
    assert not Bench().step().grip


@pytest.fixture
def apart():
    """Return a controller that has decided once, and the estimates of robot and parts of the next ticks."""
    bench = Bench()
    bench.decide()

    def estimates(tick):
        robot = Estimate(x=0.01 * tick, y=0.0, theta=0.0, covariance=(1e-6,) * 9, n_eff=100.0)
        found = PartsEstimate(parts=tuple(PartEstimate(x=x, y=y, variance=1e-6, seen=True) for x, y in AWAY), held=-1)
        return bench.told(found, tick), bench.told(robot, tick)

    return bench, estimates


def moves(command):
    return math.hypot(command.vx, command.vy) > 0.0


def thawed(bench):
    second = Bench()
    second.node.thaw(bench.node.freeze())
    second.tick = bench.tick
    return second


def test_the_parts_may_come_a_step_before_the_robot_that_they_belong_to(apart):
    bench, estimates = apart
    parts_2, robot_2 = estimates(2)
    assert moves(bench.step(*estimates(1), parts_2))
    second = thawed(bench)
    command = bench.step(robot_2)
    assert moves(command)
    assert second.step(robot_2) == command, "the early estimate is part of the state"


def test_estimates_of_two_ticks_are_never_taken_together(apart):
    bench, estimates = apart
    (parts_1, robot_1), (_, robot_2), (parts_3, _) = (estimates(tick) for tick in (1, 2, 3))
    assert not moves(bench.step(parts_1, robot_2))
    assert not moves(bench.step(robot_2, parts_3))
    assert not moves(bench.step(robot_1))
    assert not moves(bench.step(parts_3))


def test_of_several_estimates_the_newest_counts(apart):
    bench, estimates = apart
    second = thawed(bench)
    assert bench.step(*estimates(1), *estimates(2)) == second.step(*estimates(2))


def test_a_thawed_controller_continues_as_the_first():
    first = Bench()
    first.decide()
    second = thawed(first)
    assert first.decide(robot=(0.1, 0.1)) == second.decide(robot=(0.1, 0.1))
    assert state_digest(first.node.freeze()) == state_digest(second.node.freeze())
    assert state_digest(first.node.freeze()) != state_digest(Bench().node.freeze())


ALIKE = RearrangementTask(
    parts=tuple(PartSpec(radius=0.08, goal=goal) for goal in GOALS), robot_radius=0.08, interchangeable=((0, 1),)
)


def certain(robot=1.0, parts=(1.0, 1.0, 1.0), among=()):
    return Identities(robot=robot, parts=parts, robot_among=among)


def test_interchangeable_parts_take_the_nearer_goals():
    """Parts 0 and 1 lie at each other's goals; only part 2 has a way to go."""
    places = (GOALS[1], GOALS[0], (0.0, -0.7))
    shared, own = (Bench(task) for task in (ALIKE, msgspec.structs.replace(ALIKE, interchangeable=())))
    assert shared.decide(parts=places).target == 2
    assert shared.node.freeze()["goals"].tolist() == [1, 0, 2]
    assert not own.node.freeze().get("goals")
    for _ in range(20):
        last = shared.decide(parts=(*places[:2], GOALS[2]))
        other = own.decide(parts=(*places[:2], GOALS[2]))
    assert last.finished
    assert not other.finished


def test_a_robot_that_is_not_sure_which_disc_it_is_moves_and_waits():
    bench = Bench(ALIKE)
    steps = [bench.decide(identities=certain(robot=0.5, among=(1,))) for _ in range(14)]
    assert {step.mode for step in steps} == {"look"}
    assert not any(step.grip for step in steps)
    moved = [math.hypot(step.vx, step.vy) > 0.0 for step in steps]
    assert moved == [True, True, True] + [False] * 10 + [True]
    assert bench.decide(identities=certain()).mode == "mate"


def test_no_move_to_find_out_runs_into_what_stands_beside_any_of_the_discs():
    """The robot, or part 0 that may be the robot, has others on three sides: only down is free of both."""
    bench = Bench(ALIKE)
    crowd = ((0.5, 0.0), (0.5, 0.18), (0.0, 0.18))
    step = bench.decide(robot=(0.0, 0.0), parts=crowd, identities=certain(robot=0.5, among=(0,)))
    assert step.vy < 0.0
    assert abs(step.vx) < abs(step.vy)


def test_parts_of_doubtful_identity_are_left_alone_and_the_run_is_not_finished():
    """Both lie where they should, if they are who they are taken for."""
    bench = Bench(ALIKE, doubt_ticks=20)
    places = (GOALS[0], GOALS[1], AWAY[2])
    doubt = certain(parts=(0.5, 0.5, 1.0))
    assert bench.decide(parts=places, identities=doubt).target == 2
    bench = Bench(ALIKE, doubt_ticks=20)
    steps = [bench.decide(parts=GOALS, identities=doubt) for _ in range(40)]
    assert steps[-1].mode == "undecided"
    assert not any(step.finished for step in steps)
    sure = Bench(ALIKE, doubt_ticks=20)
    assert [sure.decide(parts=GOALS, identities=certain()) for _ in range(40)][-1].finished


def test_the_jaws_close_when_the_switch_does_though_the_part_seems_farther():
    """It seems 2.5 cm away, with a deviation of 6 mm; without the switch the robot goes on."""
    task = RearrangementTask(parts=(PartSpec(radius=0.08, goal=(0.9, 0.0)),), robot_radius=0.08)
    at = ((0.185, 0.0),)
    closed = [Bench(task).decide(parts=at, sigma=0.004, contact=contact) for contact in (True, False)]
    assert [step.grip for step in closed] == [True, False]
