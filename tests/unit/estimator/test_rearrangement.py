"""The rearrangement estimator: identities kept through missed, extra and swapped detections; carrying; recovery."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from dynpf_protocol.messages import Command
from dynpf_runtime.node import Received, Step, state_digest
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.estimator import RearrangementEstimator
from dynpf_systems.parts.messages import Detection, Detections, Gripper, PartEstimate, PartsCommand
from dynpf_systems.parts.task import PartSpec, RearrangementTask

from dynpf.rng import generator

TASK = RearrangementTask(
    parts=(
        PartSpec(radius=0.06, goal=(0.0, 0.55)),
        PartSpec(radius=0.08, goal=(-0.476, -0.275)),
        PartSpec(radius=0.11, goal=(0.476, -0.275)),
    )
)
TICK_NS = 50_000_000
ROBOT = (0.1, 0.2)
PARTS = ((0.5, 0.4), (-0.4, 0.5), (0.1, -0.5))
RADII = (0.10, 0.06, 0.08, 0.11)
VARIANCE = 0.2e-4
IDLE = (Command(), PartsCommand(mode="idle"))


class Found(NamedTuple):
    """The estimates of robot and parts of one step."""

    x: float
    y: float
    covariance: tuple[float, ...]
    parts: tuple[PartEstimate, ...]
    held: int


def found(outputs):
    """Return what a step estimated, None if nothing; whatever wakes its readers comes behind what belongs to it."""
    by_topic = {output.topic: output.message for output in outputs}
    if "estimator/state" not in by_topic:
        return None
    topics = list(by_topic)
    assert topics.index("estimator/parts") < topics.index("estimator/state")
    parts, robot = by_topic["estimator/parts"], by_topic["estimator/state"]
    return Found(robot.x, robot.y, robot.covariance, parts.parts, parts.held)


class Bench:
    """An estimator fed by hand: a static scene unless told otherwise, noise of the configured variance."""

    def __init__(self, seed=1, **config):
        self.node = RearrangementEstimator(
            config=RearrangementConfig(measurement_variance=VARIANCE, **config), seed=seed, tick_s=0.05, task=TASK
        )
        self.tick = 0
        self.outputs = {}

    def see(self, *, robot=ROBOT, parts=PARTS, missing=(), extra=(), command=IDLE, contact=False, theta=0.0):
        noise = math.sqrt(VARIANCE) * generator(7, "world", self.tick).standard_normal((4, 2))
        discs = [
            Detection(x=x + dx, y=y + dy, radius=radius, grey=60.0 if index else -60.0)
            for index, ((x, y), radius, (dx, dy)) in enumerate(zip((robot, *parts), RADII, noise.tolist(), strict=True))
            if index not in missing
        ]
        order = generator(7, "world", self.tick, "order").permutation(len(discs) + len(extra))
        shuffled = [[*discs, *extra][index] for index in order]
        return self.step(
            ("sensors/overhead", Detections(discs=tuple(shuffled))),
            ("sensors/gripper", Gripper(contact=contact, theta=theta)),
            ("controller/command", command[0]),
            ("controller/parts", command[1]),
        )

    def step(self, *messages):
        stamp = self.tick * TICK_NS
        inputs = tuple(Received(topic, "peer", "boot", self.tick, stamp, message) for topic, message in messages)
        result = self.node.step(Step(self.tick, self.tick, stamp, inputs))
        self.tick += 1
        self.outputs = {output.topic: output.message for output in result.outputs}
        return found(result.outputs)


def errors(estimate, robot=ROBOT, parts=PARTS):
    places = [(estimate.x, estimate.y), *((part.x, part.y) for part in estimate.parts)]
    return [math.dist(one, true) for one, true in zip(places, (robot, *parts), strict=True)]


def test_finds_everything_by_radius_at_once_and_settles():
    bench = Bench()
    first = bench.see()
    assert max(errors(first)) < 0.02
    for _ in range(40):
        last = bench.see()
    assert max(errors(last)) < 0.01
    assert all(part.seen for part in last.parts)
    assert last.parts[0].variance < VARIANCE / 5
    assert np.all(np.linalg.eigvalsh(np.reshape(last.covariance, (3, 3))) > 0)


def test_says_nothing_until_everything_has_been_seen():
    bench = Bench()
    assert bench.see(missing=(2,)) is None
    assert bench.see() is not None


def test_a_missed_disc_keeps_its_place_and_is_marked():
    bench = Bench()
    for _ in range(10):
        before = bench.see()
    for _ in range(5):
        after = bench.see(missing=(0, 2))
    assert [part.seen for part in after.parts] == [True, False, True]
    assert max(errors(after)) < 0.02
    assert after.parts[1].variance > before.parts[1].variance
    assert after.covariance[0] > before.covariance[0]


def test_a_false_disc_takes_nobodys_place():
    bench = Bench()
    for _ in range(10):
        bench.see()
    for _ in range(5):
        close = Detection(x=PARTS[1][0] + 0.03, y=PARTS[1][1], radius=0.08, grey=60.0)
        far = Detection(x=-0.7, y=-0.7, radius=0.06, grey=60.0)
        estimate = bench.see(missing=(1,), extra=(close, far))
    assert not estimate.parts[0].seen
    assert max(errors(estimate)) < 0.015


def test_two_parts_of_a_size_keep_their_identity_side_by_side():
    """The order of detections says nothing: identities come from where the discs were."""
    task = RearrangementTask(parts=tuple(PartSpec(radius=0.08, goal=(0.0, 0.0)) for _ in range(2)))
    node = RearrangementEstimator(config=RearrangementConfig(), seed=1, tick_s=0.05, task=task)
    first, second = (Detection(x=x, y=0.0, radius=0.08, grey=60.0) for x in (-0.09, 0.09))
    robot = Detection(x=0.0, y=0.6, radius=0.1, grey=-60.0)
    orders = [(first, second, robot)] + [(robot, second, first), (second, first, robot)] * 5
    seen = []
    for tick, discs in enumerate(orders):
        item = Received("sensors/overhead", "sensors", "boot", tick, tick * TICK_NS, Detections(discs=discs))
        estimate = found(node.step(Step(tick, tick, tick * TICK_NS, (item,))).outputs)
        seen.append([part.x for part in estimate.parts])
    np.testing.assert_allclose(seen, [[-0.09, 0.09]] * len(orders), atol=0.002)


def test_radii_read_the_wrong_way_round_swap_nobody():
    """Two parts of almost one size, whose radii are mislabelled for a while: where they are tells them apart."""
    task = RearrangementTask(parts=tuple(PartSpec(radius=radius, goal=(0.0, 0.0)) for radius in (0.08, 0.084)))
    node = RearrangementEstimator(config=RearrangementConfig(), seed=1, tick_s=0.05, task=task)
    places = ((-0.12, 0.0), (0.12, 0.0))
    for tick in range(30):
        radii = (0.084, 0.08) if tick >= 5 else (0.08, 0.084)
        discs = [Detection(x=x, y=y, radius=radius, grey=60.0) for (x, y), radius in zip(places, radii, strict=True)]
        discs.append(Detection(x=0.0, y=0.6, radius=0.1, grey=-60.0))
        item = Received("sensors/overhead", "sensors", "boot", tick, tick * TICK_NS, Detections(discs=tuple(discs)))
        estimate = found(node.step(Step(tick, tick, tick * TICK_NS, (item,))).outputs)
    np.testing.assert_allclose([part.x for part in estimate.parts], [-0.12, 0.12], atol=0.002)


def test_a_hidden_part_keeps_its_name_while_its_double_is_carried_past():
    """The other's disc comes within a hair of the hidden part's place, and is still the one in the gripper."""
    task = RearrangementTask(parts=tuple(PartSpec(radius=0.06, goal=(0.0, 0.0)) for _ in range(2)))
    config = RearrangementConfig(measurement_variance=5e-4)
    node = RearrangementEstimator(config=config, seed=1, tick_s=0.05, task=task)
    random = np.random.default_rng(1)
    hidden, distance = np.array([0.0, 0.0]), 0.1 + 0.06 + 0.01
    for tick in range(80):
        robot = np.array([-0.6 + 0.015 * max(tick - 10, 0), -0.30])
        held = robot + np.array([0.0, distance])
        seen = [(robot, 0.1, -60.0), (held, 0.06, 60.0)] + ([(hidden, 0.06, 60.0)] if tick < 10 else [])
        discs = [
            Detection(x=x, y=y, radius=radius, grey=grey)
            for place, radius, grey in seen
            for x, y in [(place + math.sqrt(5e-4) * random.standard_normal(2)).tolist()]
        ]
        messages = (
            ("sensors/overhead", Detections(discs=tuple(discs))),
            ("sensors/gripper", Gripper(contact=tick >= 1, theta=math.pi / 2)),
            ("controller/command", Command(vx=0.3 if tick > 10 else 0.0)),
            ("controller/parts", PartsCommand(mode="move", target=1, grip=True)),
        )
        if tick == 0:  # which is which, from where they are known to be
            node.thaw({**node.freeze(), "parts": np.array([hidden, held]), "variances": np.full(2, 0.01)})
        inputs = tuple(Received(topic, "peer", "boot", tick, tick * TICK_NS, message) for topic, message in messages)
        estimate = found(node.step(Step(tick, tick, tick * TICK_NS, inputs)).outputs)
    assert math.dist((estimate.parts[0].x, estimate.parts[0].y), hidden) < 0.03
    assert not estimate.parts[0].seen
    assert math.dist((estimate.parts[1].x, estimate.parts[1].y), held) < 0.03


def test_a_robot_as_large_as_a_part_is_told_by_its_grey():
    task = RearrangementTask(parts=(PartSpec(radius=0.1, goal=(0.0, 0.0)),))
    discs = (Detection(x=0.5, y=0.0, radius=0.1, grey=60.0), Detection(x=-0.5, y=0.0, radius=0.1, grey=-60.0))
    config = RearrangementConfig(robot_grey=-60.0, part_grey=60.0)
    for order in (discs, discs[::-1]):
        node = RearrangementEstimator(config=config, seed=1, tick_s=0.05, task=task)
        item = Received("sensors/overhead", "sensors", "boot", 0, 0, Detections(discs=order))
        estimate = found(node.step(Step(0, 0, 0, (item,))).outputs)
        assert (round(estimate.x, 1), round(estimate.parts[0].x, 1)) == (-0.5, 0.5)


def test_the_robot_is_carried_along_by_the_last_command():
    bench = Bench()
    command = (Command(vx=0.1, vy=-0.2), PartsCommand(mode="mate", target=0))
    for tick in range(20):
        where = (ROBOT[0] + 0.005 * tick, ROBOT[1] - 0.01 * tick)
        estimate = bench.see(robot=where, command=command)
    assert errors(estimate, robot=where)[0] < 0.01
    for _ in range(5):
        unseen = bench.see(command=command, missing=(0,))
    where = (ROBOT[0] + 0.005 * 24, ROBOT[1] - 0.01 * 24)
    assert errors(unseen, robot=where)[0] < 0.02


def test_a_held_part_goes_with_the_gripper_and_helps_to_see_the_robot():
    bench, plain = Bench(), Bench()
    distance = 0.1 + 0.08 + 0.01
    theta = 0.6
    hold = (Command(), PartsCommand(mode="move", target=1, grip=True))
    held_at = (ROBOT[0] + distance * math.cos(theta), ROBOT[1] + distance * math.sin(theta))
    parts = (PARTS[0], held_at, PARTS[2])
    for _ in range(30):
        held = bench.see(parts=parts, command=hold, contact=True, theta=theta)
        free = plain.see(parts=parts, theta=theta)
    assert (held.held, free.held) == (1, -1)
    offset = (held.parts[1].x - held.x, held.parts[1].y - held.y)
    assert offset == pytest.approx((distance * math.cos(theta), distance * math.sin(theta)))
    assert held.covariance[0] < 0.75 * free.covariance[0]
    occluded = bench.see(parts=parts, command=hold, contact=True, theta=theta, missing=(0,))
    assert errors(occluded, parts=parts)[0] < 0.015


def test_without_contact_nothing_is_held():
    bench = Bench()
    assert bench.see(command=(Command(), PartsCommand(mode="mate", target=1, grip=True))).held == -1


def test_a_part_that_was_moved_is_found_again():
    bench = Bench(lost_after=10)
    for _ in range(5):
        bench.see()
    moved = ((-0.5, -0.4), *PARTS[1:])
    for _ in range(9):
        estimate = bench.see(parts=moved)
    assert errors(estimate, parts=PARTS)[1] < 0.02
    for _ in range(5):
        estimate = bench.see(parts=moved)
    assert max(errors(estimate, parts=moved)) < 0.02


def test_a_robot_that_was_moved_is_found_again():
    bench = Bench(lost_after=10)
    for _ in range(5):
        bench.see()
    for _ in range(12):
        estimate = bench.see(robot=(-0.6, -0.6))
    assert errors(estimate, robot=(-0.6, -0.6))[0] < 0.02


def test_no_frame_is_no_miss():
    bench = Bench(lost_after=3)
    bench.see()
    for _ in range(6):
        estimate = bench.step(("sensors/gripper", Gripper(contact=False, theta=0.0)))
    assert estimate is not None
    assert not any(part.seen for part in estimate.parts)
    assert max(errors(estimate)) < 0.03


def test_an_empty_frame_changes_no_mean():
    bench = Bench()
    before = bench.see()
    after = bench.step(("sensors/overhead", Detections(discs=())))
    assert [(part.x, part.y) for part in after.parts] == [(part.x, part.y) for part in before.parts]


def test_consistency_of_the_robots_covariance():
    """The normalized estimation error squared averages 2, the dimension; half the noise would double it."""
    nees = []
    for seed in range(6):
        bench = Bench(seed=seed)
        random = generator(seed, "truth", 0)
        robot = np.array(ROBOT)
        for tick in range(60):
            if tick:
                robot = robot + math.sqrt(0.06e-4) * random.standard_normal(2)
            noise = math.sqrt(VARIANCE) * random.standard_normal(2)
            disc = Detection(x=robot[0] + noise[0], y=robot[1] + noise[1], radius=0.1, grey=0.0)
            others = [
                Detection(x=x, y=y, radius=radius, grey=0.0) for (x, y), radius in zip(PARTS, RADII[1:], strict=True)
            ]
            estimate = bench.step(("sensors/overhead", Detections(discs=(disc, *others))))
            offset = np.array([estimate.x, estimate.y]) - robot
            covariance = np.reshape(estimate.covariance, (3, 3))[:2, :2]
            nees.append(offset @ np.linalg.solve(covariance, offset))
    assert 1.5 < np.mean(nees) < 2.6


def test_the_cloud_is_small_and_comes_five_times_a_second():
    bench = Bench(n=1000)
    clouds = []
    for tick in range(9):
        bench.see()
        if "estimator/particles" in bench.outputs:
            clouds.append((tick, len(bench.outputs["estimator/particles"].poses)))
    assert clouds == [(0, 200), (4, 200), (8, 200)]


@pytest.mark.parametrize("name", ["optimal", "auxiliary", "extended_kalman"])
def test_a_thawed_estimator_continues_as_the_first(name):
    first, second, other = Bench(filter=name), Bench(filter=name), Bench(seed=2, filter=name)
    for _ in range(5):
        first.see()
        other.see()
    second.node.thaw(first.node.freeze())
    second.tick = first.tick
    assert first.see() == second.see()
    assert state_digest(first.node.freeze()) == state_digest(second.node.freeze())
    assert state_digest(first.node.freeze()) != state_digest(other.node.freeze())
