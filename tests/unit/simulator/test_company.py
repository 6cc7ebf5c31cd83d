"""People, doors and a driver: nobody walks through walls, doors keep their times, the route is driven to its end."""

import math
from functools import partial

import msgspec
import numpy as np
import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import RobotState
from dynpf_runtime.node import Result, Step, decode_state, encode_state
from dynpf_systems.rooms.clearance import from_segments
from dynpf_systems.rooms.company import closed_doors
from dynpf_systems.rooms.config import Door, Driver, PeopleParams, RoomConfig
from dynpf_systems.rooms.maps import Maps
from dynpf_systems.rooms.messages import Obstacles
from dynpf_systems.rooms.world import RoomSimulator

from dynpf.maps.segments import SegmentMap

# Two rooms of 3 m by 3 m, and a doorway between y = 1 and y = 2.
WALLS = SegmentMap([(0, 0, 6, 0), (6, 0, 6, 3), (6, 3, 0, 3), (0, 3, 0, 0), (3, 0, 3, 1), (3, 2, 3, 3)])
MAPS = Maps(segments=WALLS, grid=WALLS.rasterize(0.05))
DOOR = (3.0, 1.0, 3.0, 2.0)
TICK_S = 0.1


def room(seed: int = 1, **config: object) -> RoomSimulator:
    usual = RoomConfig(start=(1.5, 1.5, 0.0), driver=Driver(points=((4.5, 1.5),), speed=0.5))
    return RoomSimulator(config=msgspec.structs.replace(usual, **config), seed=seed, tick_s=TICK_S, maps=MAPS)


def run(node: RoomSimulator, ticks: range) -> list[Result]:
    return [node.step(Step(tick, tick, tick * 100_000_000, ())) for tick in ticks]


def told(result: Result) -> tuple[RobotState, Obstacles]:
    by_topic = {output.topic: output.message for output in result.outputs}
    robot, obstacles = by_topic["truth/robot"], by_topic["truth/obstacles"]
    assert isinstance(robot, RobotState)
    assert isinstance(obstacles, Obstacles)
    return robot, obstacles


def test_people_walk_at_their_speed_and_never_through_walls_or_closed_doors() -> None:
    node = room(people=PeopleParams(number=5, speed=1.0, radius=0.2), doors=(Door(segment=DOOR, open_for=0.0),))
    clearance = from_segments(np.concatenate([WALLS.segments, [DOOR]]))
    places = np.array([[(one.x, one.y) for one in told(result)[1].people] for result in run(node, range(300))])
    assert min(clearance(x, y) for x, y in places.reshape(-1, 2).tolist()) >= 0.2 - 1e-9
    strides = np.hypot(*np.moveaxis(np.diff(places, axis=0), 2, 0))
    assert strides.max() <= 1.0 * TICK_S + 1e-9
    assert (strides > 0.0).mean() > 0.5
    # The closed door keeps everybody in the room of the start.
    assert (np.sign(places[:, :, 0] - 3.0) == np.sign(places[0, :, 0] - 3.0)).all()


def test_a_door_is_open_at_its_times_and_for_a_robot_that_is_near() -> None:
    door = Door(segment=DOOR, period=10.0, open_for=4.0, phase=1.0, opens_within=0.5)
    far, near = (1.0, 1.5), (2.6, 1.5)
    shut = [len(closed_doors([door], time, far)) for time in (0.0, 1.5, 4.9, 5.1, 10.9, 11.1)]
    assert shut == [1, 0, 0, 1, 1, 0]
    assert len(closed_doors([door], 0.0, near)) == 0


def test_the_driver_waits_before_a_closed_door_and_ends_with_the_route() -> None:
    # Open from 20 s on: until then the robot stands 0.3 m off, at x = 3 - 0.15 - 0.3.
    node = room(doors=(Door(segment=DOOR, period=1000.0, open_for=500.0, phase=20.0),))
    results = run(node, range(199))
    robot, _ = told(results[-1])
    assert robot.x == pytest.approx(2.55, abs=0.06)
    assert robot.v == 0.0
    last = next(result for result in run(node, range(199, 500)) if result.finished)
    assert math.dist((told(last)[0].x, told(last)[0].y), (4.5, 1.5)) <= 0.15
    assert not any(result.finished for result in results)


def test_the_driver_stops_before_people() -> None:
    node = room(people=PeopleParams(number=3, speed=0.8, radius=0.2))
    for result in run(node, range(200)):
        robot, obstacles = told(result)
        gaps = [math.dist((robot.x, robot.y), (one.x, one.y)) - 0.2 - 0.15 for one in obstacles.people]
        assert min(gaps) > -0.1
        if result.finished:
            break


def test_a_thawed_room_goes_on_as_the_frozen_one_and_another_seed_does_not() -> None:
    lively = partial(room, people=PeopleParams(number=3), doors=(Door(segment=DOOR),))
    first, second, other = lively(), lively(), lively(seed=2)
    run(first, range(50))
    second.thaw(decode_state(encode_state(first.freeze())))
    expected = run(first, range(50, 90))
    assert run(second, range(50, 90)) == expected
    assert [told(one)[1].people for one in run(other, range(5))] != [told(one)[1].people for one in expected[:5]]


def test_people_and_doors_need_a_map_and_room() -> None:
    with pytest.raises(ScenarioError, match=r"need a \[map\]"):
        RoomSimulator(config=RoomConfig(doors=(Door(segment=DOOR),)), seed=1, tick_s=TICK_S)
    with pytest.raises(ScenarioError, match="no room"):
        room(people=PeopleParams(number=1, radius=2.0))
