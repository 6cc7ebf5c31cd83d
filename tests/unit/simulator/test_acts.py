"""Simulated worlds do what a person does to them, and refuse what cannot be; their state has it while it lasts."""

import math

import pytest
from dynpf_protocol.messages import Drive, HoldMap, Message, Move, Place, PlaceBody, RobotState, SetDoor
from dynpf_runtime.node import Node, Received, Refusing, Step, decode_state, encode_state
from dynpf_services.scenario.build import build_nodes
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.colon.messages import CapsuleState
from dynpf_systems.parts.messages import PartsState
from dynpf_systems.rooms.messages import Obstacles


class World:
    """The simulator of a scenario, and its ticks."""

    def __init__(self, scenario: str, *overrides: str) -> None:
        self._resolved = load_scenario(scenario, overrides=overrides)
        self.node: Node = build_nodes(self._resolved)["simulator"]
        self.tick = 0

    def step(self, *acts: Message) -> dict[str, Message]:
        """Let a tick pass in which a person acts, and return what the world says, by topic."""
        assert isinstance(self.node, Refusing)
        assert [self.node.refuses(act) for act in acts] == [""] * len(acts)
        stamp_ns = self.tick * self._resolved.tick_ns
        inputs = tuple(Received("", "simulator", "boot", number, stamp_ns, act) for number, act in enumerate(acts))
        result = self.node.step(Step(self.tick, self.tick, stamp_ns, inputs))
        self.tick += 1
        again = build_nodes(self._resolved)["simulator"]
        again.thaw(decode_state(encode_state(self.node.freeze())))
        assert encode_state(again.freeze()) == encode_state(self.node.freeze())
        self.node = again  # what it forgets by that, it does not go on with
        return {output.topic: output.message for output in result.outputs}

    def robot(self, *acts: Message) -> RobotState:
        state = self.step(*acts)["truth/robot"]
        assert isinstance(state, RobotState)
        return state

    def refuses(self, act: Message) -> str:
        assert isinstance(self.node, Refusing)
        return self.node.refuses(act)


def test_a_robot_in_a_room_is_carried_within_the_tick_and_drives_on_from_there() -> None:
    world = World("landmark-room")
    world.step()
    there = world.robot(Place(x=1.0, y=-0.5, theta=3.0 * math.pi))
    assert (there.x, there.y, abs(there.theta)) == (1.0, -0.5, math.pi)
    assert "does not fit into the room at (9.000, 0.000)" in world.refuses(Place(x=9.0, y=0.0, theta=0.0))


def test_a_robot_is_driven_for_as_long_as_the_act_lasts() -> None:
    world = World("landmark-room", "tick_s=0.1")
    speeds = [world.robot(Drive(v=0.2, w=0.3, lasts_s=0.25)).v, *(world.robot().v for _ in range(4))]
    assert [speed > 0.1 for speed in speeds] == [True, True, True, False, False]
    assert "driven" not in world.node.freeze()
    assert world.robot(Drive(v=50.0)).v < 2.0  # as fast as it can


def test_a_door_is_held_until_it_is_left_to_the_scenario() -> None:
    world = World("indoor-tracking")
    planned = closed(world.step())
    shut = closed(world.step(*(SetDoor(door=door, to="closed") for door in range(4))))
    assert shut == 4 > planned
    assert closed(world.step()) == 4
    assert closed(world.step(*(SetDoor(door=door, to="open") for door in range(4)))) == 0
    assert closed(world.step(*(SetDoor(door=door, to="scheduled") for door in range(4)))) == planned
    assert "held_doors" not in world.node.freeze()
    assert world.refuses(SetDoor(door=4, to="open")) == "there is no door 5; the room has 4"


def closed(told: dict[str, Message]) -> int:
    obstacles = told["truth/obstacles"]
    assert isinstance(obstacles, Obstacles)
    return len(obstacles.doors)


def test_parts_and_their_robot_are_put_elsewhere_but_not_onto_each_other() -> None:
    world = World("parts-3-easy")
    told = world.step()
    parts, robot = told["truth/parts"], told["truth/robot"]
    assert isinstance(parts, PartsState)
    assert isinstance(robot, RobotState)
    there = world.step(PlaceBody(body=1, x=0.0, y=-0.9))["truth/parts"]
    assert isinstance(there, PartsState)
    assert (there.parts[1].x, there.parts[1].y) == (0.0, -0.9)
    onto = world.refuses(PlaceBody(body=0, x=0.0, y=-0.9))
    assert onto == "part 1 would touch another disc at (0.000, -0.900) m"
    assert "the robot would touch another disc" in world.refuses(Place(x=0.0, y=-0.9, theta=0.0))
    assert "does not fit into the workspace" in world.refuses(Place(x=0.0, y=0.99, theta=0.0))
    assert world.refuses(PlaceBody(body=7, x=0.0, y=0.0)) == "there is no part 8; the task has 3"
    carried = world.robot(Place(x=0.9, y=-0.85, theta=1.0))
    assert (carried.x, carried.y, carried.theta) == (0.9, -0.85, 1.0)
    moved = [world.robot(Move(vx=-0.5, vy=0.0, lasts_s=1.0)), *(world.robot() for _ in range(5))]
    assert moved[-1].x < 0.85
    assert moved[-1].y == pytest.approx(-0.85, abs=0.05)


def test_a_capsule_is_carried_in_its_tube_whose_map_a_person_changes() -> None:
    world = World("colon-case-2")
    first = world.step()["truth/capsule"]
    assert isinstance(first, CapsuleState)
    assert first.map == "a"
    held = world.step(HoldMap(map="b"), Place(x=400.0, y=370.0, theta=0.1))["truth/capsule"]
    assert isinstance(held, CapsuleState)
    assert (held.map, held.x_px, held.y_px, held.theta) == ("b", 400.0, 370.0, 0.1)
    after = world.step(HoldMap(map=""))["truth/capsule"]
    assert isinstance(after, CapsuleState)
    assert after.map == "a"
    assert "is not inside the tube" in world.refuses(Place(x=1.0, y=1.0, theta=0.0))
    assert world.refuses(HoldMap(map="z")) == "map 'z' is never true in this run; there are a, b"
