"""The room simulator: exact arcs, noise against its parameters, walls, its clock's end, and its state."""

import math

import msgspec
import numpy as np
import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Command, RobotState, SceneUpdate
from dynpf_runtime.node import Received, Result, Step, decode_state, encode_state
from dynpf_systems.rooms.config import RoomConfig
from dynpf_systems.rooms.maps import Maps
from dynpf_systems.rooms.world import RoomSimulator

from dynpf.maps.segments import SegmentMap

TICK_S = 0.05
TICK_NS = 50_000_000
LANDMARKS = (Landmark(id=6, x=2.0, y=1.0), Landmark(id=7, x=-2.0, y=1.0))
DRIVE = Command(vx=0.5, w=0.4)


def room(seed: int = 1, **config: object) -> RoomSimulator:
    chosen = msgspec.structs.replace(RoomConfig(), **config)
    return RoomSimulator(config=chosen, seed=seed, tick_s=TICK_S, landmarks=LANDMARKS)


def advance(node: RoomSimulator, tick: int, command: Command | None = None) -> Result:
    inputs = (
        () if command is None else (Received("controller/command", "controller", "b", tick, tick * TICK_NS, command),)
    )
    return node.step(Step(tick, tick, tick * TICK_NS, inputs))


def state(result: Result) -> RobotState:
    message = result.outputs[0].message
    assert isinstance(message, RobotState)
    return message


def test_one_metre_and_one_radian_a_second_trace_a_circle_of_radius_one() -> None:
    # LANDMARK: constant 1 m/s and 1 rad/s is a circle of radius 1, here about (0, 1) from (0, 0, 0).
    node = room(width=10.0, height=10.0)
    advance(node, 0, Command(vx=1.0, w=1.0))
    for tick in range(1, 61):
        here, seconds = state(advance(node, tick)), tick * TICK_S
        assert (here.x, here.y) == pytest.approx((math.sin(seconds), 1 - math.cos(seconds)), abs=1e-12)
        assert here.theta == pytest.approx(seconds, abs=1e-12)
    here = state(advance(node, 61))
    assert (here.v, here.w) == (1.0, 1.0)


def test_the_twist_told_is_the_one_that_leads_to_the_next_pose() -> None:
    node = room(start=(0.5, -0.5, math.pi / 2))
    assert state(advance(node, 0)) == RobotState(x=0.5, y=-0.5, theta=math.pi / 2)
    assert state(advance(node, 1, DRIVE)) == RobotState(x=0.5, y=-0.5, theta=math.pi / 2, v=0.5, w=0.4)
    halted = state(advance(node, 2, Command()))
    assert halted.theta == pytest.approx(math.pi / 2 + 0.4 * TICK_S)
    assert (halted.v, halted.w) == (0.0, 0.0)
    assert math.dist((halted.x, halted.y), (0.5, -0.5)) == pytest.approx(0.5 * TICK_S, rel=1e-3)
    assert state(advance(node, 3)) == halted


def test_commands_beyond_the_limits_are_cut() -> None:
    node = room(max_speed=0.3, max_turn_rate=0.2)
    after = state(advance(node, 0, Command(vx=-5.0, w=9.0)))
    assert (after.v, after.w) == (-0.3, 0.2)


def test_motion_noise_has_the_variances_of_its_parameters() -> None:
    # Turning as fast as driving, within a room so large that no wall is met.
    node = room(width=1000.0, height=1000.0, alpha=(0.01, 0.02, 0.03, 0.04, 0.05, 0.06))
    v, w, count = 0.5, 0.4, 4000
    advance(node, 0, DRIVE)
    states = [state(advance(node, tick)) for tick in range(1, count + 1)]
    theta = np.unwrap([s.theta for s in states])
    spins = np.diff(theta) / TICK_S - np.array([s.w for s in states[:-1]])
    for samples, mean, variance in (
        (np.array([s.v for s in states]), v, 0.01 * v**2 + 0.02 * w**2),
        (np.array([s.w for s in states]), w, 0.03 * v**2 + 0.04 * w**2),
        (spins, 0.0, 0.05 * v**2 + 0.06 * w**2),
    ):
        assert abs(samples.mean() - mean) < 5 * math.sqrt(variance / count)
        assert abs(samples.var() / variance - 1) < 5 * math.sqrt(2 / count)


def test_walls_hold_the_robot() -> None:
    node = room(width=2.0, height=2.0, robot_radius=0.2)
    advance(node, 0, Command(vx=1.0))
    last = [state(advance(node, tick)) for tick in range(1, 60)][-1]
    assert (last.x, last.y) == (0.8, 0.0)


def test_a_start_outside_the_room_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"does not fit .* 6\.0 m x 4\.0 m"):
        room(start=(2.9, 0.0, 0.0))


def test_it_ends_with_the_command() -> None:
    node = room()
    assert not advance(node, 0, DRIVE).finished
    assert advance(node, 1, Command(finished=True)).finished


def test_the_scene_shows_room_landmarks_and_robot_five_times_a_second() -> None:
    node = room()
    results = [advance(node, tick, DRIVE) for tick in range(41)]
    scenes = [output.message for result in results for output in result.outputs if output.topic == "truth/scene"]
    assert len(scenes) == 11  # over two seconds, both ends counted
    last = scenes[-1]
    assert isinstance(last, SceneUpdate)
    assert [entity.id for entity in last.entities] == ["room", "landmarks", "robot"]
    assert [text.text for text in last.entities[1].texts] == ["6", "7"]
    here = state(results[40])
    assert (last.entities[2].cylinders[0].pose.position.x, last.entities[2].cylinders[0].pose.position.y) == (
        here.x,
        here.y,
    )


def test_a_thawed_room_continues_exactly_and_another_seed_does_not() -> None:
    alpha = (0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
    first, second, other = room(alpha=alpha), room(alpha=alpha), room(seed=2, alpha=alpha)
    for tick in range(7):
        advance(first, tick, DRIVE)
    for node in (second, other):
        node.thaw(decode_state(encode_state(first.freeze())))
    expected = [advance(first, tick) for tick in range(7, 20)]
    assert [advance(second, tick) for tick in range(7, 20)] == expected
    assert [advance(other, tick) for tick in range(7, 20)] != expected
    assert encode_state(second.freeze()) == encode_state(first.freeze())


WALLS = SegmentMap([(-2, -2, 2, -2), (2, -2, 2, 2), (2, 2, -2, 2), (-2, 2, -2, -2), (1, -0.5, 1, 0.5)])
MAPS = {"segments": Maps(segments=WALLS, grid=WALLS.rasterize(0.05)), "cells": Maps(grid=WALLS.rasterize(0.01, 0.5))}


def among_walls(maps: Maps, **config: object) -> RoomSimulator:
    return RoomSimulator(config=msgspec.structs.replace(RoomConfig(), **config), seed=1, tick_s=TICK_S, maps=maps)


@pytest.mark.parametrize("maps", MAPS.values(), ids=MAPS)
def test_a_wall_of_the_map_holds_the_robot_and_lets_it_go(maps: Maps) -> None:
    node = among_walls(maps, robot_radius=0.2)
    advance(node, 0, Command(vx=1.0))
    for tick in range(1, 40):
        here = state(advance(node, tick))
    assert 0.74 < here.x <= 0.8 + 0.015  # the screen at x = 1, less the radius; a cell's centre may lie a bit off it
    held = here.x
    here = state(advance(node, 40, Command(vx=-1.0)))
    here = state(advance(node, 41))
    assert here.x < held - 0.04
    beside = among_walls(maps, robot_radius=0.2, start=(0.0, 1.0, 0.0))
    advance(beside, 0, Command(vx=1.0))
    for tick in range(1, 30):
        here = state(advance(beside, tick))
    assert here.x > 1.4  # past the screen


@pytest.mark.parametrize("maps", MAPS.values(), ids=MAPS)
@pytest.mark.parametrize("start", [(0.9, 0.0, 0.0), (1.9, 0.0, 0.0), (5.0, 0.0, 0.0)])
def test_a_start_in_a_wall_of_the_map_is_refused(maps: Maps, start: tuple[float, float, float]) -> None:
    if start[0] == 5.0 and maps.segments is not None:
        return  # segments have no outside
    with pytest.raises(ScenarioError, match=r"the robot of radius 0\.15 m does not fit there in the map"):
        among_walls(maps, start=start)


def test_the_scene_shows_the_segments() -> None:
    scene = advance(among_walls(MAPS["segments"]), 0).outputs[1].message
    assert isinstance(scene, SceneUpdate)
    (walls,) = scene.entities[0].lines
    assert walls.type == 2
    assert len(walls.points) == 2 * len(WALLS)
