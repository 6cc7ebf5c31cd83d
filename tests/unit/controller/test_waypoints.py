"""The waypoint controller: gets there from anywhere, within its limits, by the estimate alone."""

import math

import msgspec
import numpy as np
import pytest
from dynpf_protocol.messages import Command, Estimate
from dynpf_runtime.node import Received, Step, decode_state, encode_state
from dynpf_systems.rooms.config import WaypointsConfig
from dynpf_systems.rooms.waypoints import WaypointController
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.se2 import arc_displacement, compose

TICK_S = 0.05
TICK_NS = 50_000_000
SQUARE = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))

Pose = tuple[float, float, float]


def arc(pose: Pose, v: float, w: float, seconds: float) -> Pose:
    x, y, theta = compose(np.array(pose), arc_displacement(v * seconds, w * seconds)).tolist()
    return x, y, theta


def controller(**config: object) -> WaypointController:
    return WaypointController(config=msgspec.structs.replace(WaypointsConfig(points=SQUARE), **config))


def estimate(pose: Pose) -> Estimate:
    x, y, theta = pose
    return Estimate(x=x, y=y, theta=math.remainder(theta, math.tau), covariance=(0.0,) * 9, n_eff=100.0)


def step(tick: int, *poses: Pose) -> Step:
    inputs = tuple(
        Received("estimator/state", "estimator", "b", i, tick * TICK_NS, estimate(p)) for i, p in enumerate(poses)
    )
    return Step(tick, tick, tick * TICK_NS, inputs)


def command(node: WaypointController, tick: int, pose: Pose) -> Command:
    (output,) = node.step(step(tick, pose)).outputs
    assert isinstance(output.message, Command)
    return output.message


def drive(node: WaypointController, pose: Pose, ticks: int) -> tuple[list[Pose], list[Command]]:
    path, commands = [pose], []
    for tick in range(ticks):
        commands.append(command(node, tick, path[-1]))
        if commands[-1].finished:
            break
        path.append(arc(path[-1], commands[-1].vx, commands[-1].w, TICK_S))
    return path, commands


@settings(derandomize=True, deadline=None, max_examples=40)
@given(x=st.floats(-2, 2), y=st.floats(-2, 2), theta=st.floats(-math.pi, math.pi))
def test_every_waypoint_is_reached_in_order_within_the_limits_from_anywhere(x: float, y: float, theta: float) -> None:
    path, commands = drive(controller(speed=0.5, turn_rate=1.0), (x, y, theta), 1000)
    assert commands[-1] == Command(finished=True)
    assert all(0.0 <= c.vx <= 0.5 and abs(c.w) <= 1.0 for c in commands)
    visits = [next((i for i, p in enumerate(SQUARE) if math.dist(p, pose[:2]) <= 0.15), None) for pose in path]
    rest = iter(visits)
    assert all(any(visit == wanted for visit in rest) for wanted in range(4))


def test_two_laps_take_twice_the_way_of_one() -> None:
    start = (1.0, -1.0, math.pi / 2)
    once, _ = drive(controller(laps=1), start, 5000)
    twice, commands = drive(controller(laps=2), start, 5000)
    assert commands[-1].finished
    assert len(twice) / len(once) == pytest.approx(2.0, rel=0.05)


def test_a_waypoint_behind_is_turned_to_on_the_spot() -> None:
    for heading, turn in ((-math.pi / 2 + 0.1, 1.0), (-math.pi / 2 - 0.1, -1.0)):  # the first waypoint lies north
        turning = command(controller(), 0, (1.0, 0.0, heading))
        assert (turning.vx, turning.w) == (0.0, turn)
    ahead = command(controller(), 0, (1.0, 0.0, math.pi / 2))
    assert (ahead.vx, ahead.w) == (0.3, 0.0)


def test_it_keeps_saying_that_it_is_done() -> None:
    node = controller(points=((0.0, 0.0),))
    assert command(node, 0, (0.0, 0.0, 0.0)).finished
    assert command(node, 1, (3.0, 0.0, 0.0)) == Command(finished=True)


def test_it_is_silent_without_an_estimate_and_goes_by_the_newest_of_several() -> None:
    node = controller()
    assert node.step(step(0)).outputs == ()
    (output,) = node.step(step(5, (1.0, 0.0, 0.0), (1.0, 0.0, math.pi / 2))).outputs
    assert output.message == Command(vx=0.3, w=0.0)
    assert node.step(step(4, (0.0, 0.0, 0.0))).outputs == ()  # older than what it has acted on


def test_a_thawed_controller_continues_exactly() -> None:
    first, second = controller(), controller()
    path, _ = drive(first, (0.0, 0.0, 0.0), 200)
    second.thaw(decode_state(encode_state(first.freeze())))
    assert first.freeze()["reached"] > 0
    expected = [command(first, 200 + tick, path[-1]) for tick in range(3)]
    assert [command(second, 200 + tick, path[-1]) for tick in range(3)] == expected
    assert [command(controller(), 200 + tick, path[-1]) for tick in range(3)] != expected
