"""Nodes of one's own: checked before they run, pure from step to step, taken out and put back as they were."""

import sys
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from dynpf_protocol.errors import ScenarioError, StepError
from dynpf_protocol.messages import RobotState
from dynpf_runtime.inline import run_inline
from dynpf_runtime.node import Received, Step, decode_state, encode_state
from dynpf_services.scenario.build import build_node, plan_of
from dynpf_services.scenario.load import load_scenario

MODULE = """
    from typing import NamedTuple

    import numpy as np
    from dynpf_lab import Message, Node, Sensor, Topic
    from dynpf_protocol.messages import RobotState


    class Count(Message, frozen=True, kw_only=True):
        schema_name = "counting.Count"
        seen: int


    class Pair(NamedTuple):
        first: int = 0
        second: float = 0.0


    class Counter(Node, frozen=True, kw_only=True):
        reads = ("truth/robot",)
        writes = {"count": Count}
        step_by: int = 1

        class State(NamedTuple):
            seen: int = 0
            pair: Pair = Pair()
            last: RobotState | None = None
            poses: np.ndarray = np.zeros((0, 2))

        def step(self, state, moment):
            truth = moment.newest(RobotState)
            if truth is None:
                return state, ()
            noise = moment.draws().standard_normal()
            poses = np.append(state.poses, [[truth.x, noise]], axis=0)
            state = state._replace(
                seen=state.seen + self.step_by, pair=Pair(state.seen, truth.x), last=truth, poses=poses
            )
            return state, [Count(seen=state.seen)]


    class Twice(Counter, frozen=True, kw_only=True):
        writes = {"one": Count, "other": Count}


    class Forgetful(Counter, frozen=True, kw_only=True):
        def step(self, state, moment):
            return None, ()


    class Loud(Counter, frozen=True, kw_only=True):
        def step(self, state, moment):
            return state, [("elsewhere", Count(seen=1))]


    class Untyped(Counter, frozen=True, kw_only=True):
        def step(self, state, moment):
            return state, [Count(seen="x")]


    class Nameless(Message, frozen=True, kw_only=True):
        seen: int


    class Anonymous(Node, frozen=True, kw_only=True):
        writes = {"count": Nameless}

        def step(self, state, moment):
            return state, ()


    class Misreader(Node, frozen=True, kw_only=True):
        reads = ("truth/robt",)

        def step(self, state, moment):
            return state, ()


    class Undecided(Counter, frozen=True, kw_only=True):
        class State(NamedTuple):
            seen: int


    class Silent(Sensor, frozen=True, kw_only=True):
        topic = "count"
        message = Count


    class Plain(Node, frozen=True, kw_only=True):
        writes = {"count": 3}

        def step(self, state, moment):
            return state, ()


    class Uncompared(Node, frozen=True, kw_only=True):
        writes = {"count": Topic(name="count", type=Count, publishers=("own",), description="", compared=False)}

        def step(self, state, moment):
            return state, ()


    class Every(Sensor, frozen=True, kw_only=True):
        topic = "count"
        message = Count

        def sense(self, truth, draws):
            return Count(seen=round(1000 * truth.x))


    class Stranger:
        pass
"""


@pytest.fixture(name="room")
def in_a_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what loads landmark-room with a node of a class of MODULE beside the others."""
    (tmp_path / "counting.py").write_text(dedent(MODULE))
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    monkeypatch.delitem(sys.modules, "counting", raising=False)

    def load(name: str, *settings: str) -> Any:
        node = f"nodes.own={{kind='counting:{name}'}}"
        return load_scenario("landmark-room", overrides=["max_ticks=6", node, *settings])

    return load


def truth(number: int, x: float) -> Step:
    message = RobotState(x=x, y=0.0, theta=0.0, v=0.0, w=0.0)
    return Step(number, number, number, (Received("truth/robot", "simulator", "b", number, number, message),))


def test_a_node_thawed_goes_on_as_the_first_would_have(room: Any) -> None:
    first, second = (build_node(room("Counter", "nodes.own.step_by=2"), "own") for _ in range(2))
    for number in range(3):
        first.step(truth(number, 0.5 + number))
    state = decode_state(encode_state(first.freeze()))
    second.thaw(state)
    assert encode_state(second.freeze()) == encode_state(first.freeze())
    assert second.step(truth(3, 9.0)) == first.step(truth(3, 9.0))
    assert encode_state(second.freeze()) == encode_state(first.freeze())
    assert state["seen"] == 6
    assert np.shape(state["poses"]) == (3, 2)
    # The control: what is forgotten in between shows.
    third = build_node(room("Counter", "nodes.own.step_by=2"), "own")
    assert third.step(truth(3, 9.0)) != first.step(truth(3, 9.0))


def test_its_random_numbers_are_those_of_seed_node_and_step(room: Any) -> None:
    def drawn(*settings: str, number: int = 4) -> float:
        node = build_node(room("Counter", *settings), "own")
        node.step(truth(number, 1.0))
        return float(node.freeze()["poses"][0][1])

    assert drawn() == drawn()
    assert len({drawn(), drawn("seed=2"), drawn(number=5)}) == 3


def test_a_sensor_reads_every_so_many_true_states(room: Any) -> None:
    node = build_node(room("Every", "nodes.own.every=3"), "own")
    said = [len(node.step(truth(number, 0.1 * number)).outputs) for number in range(7)]
    assert said == [1, 0, 0, 1, 0, 0, 1]
    assert not node.step(Step(7, 7, 7, ())).outputs


@pytest.mark.parametrize(
    ("name", "settings", "told"),
    [
        ("Counter", ["nodes.own.step_bye=2"], "nodes.own.step_bye: unknown key; counting:Counter knows step_by"),
        ("Counter", ["nodes.own.step_by='x'"], "nodes.own.step_by: expected `int`, got `str`"),
        ("Stranger", [], "nodes.own.kind: 'counting:Stranger' is no node; expected a subclass of dynpf_lab.Node"),
        ("Silent", [], "nodes.own.kind: 'counting:Silent' has no method sense"),
        ("Undecided", [], "nodes.own: Undecided.State needs a default for each of its fields"),
        ("Anonymous", [], "nodes.own: Nameless lacks its schema_name, such as schema_name = 'mylab.Nameless'"),
        ("Misreader", [], "nodes.own: reads truth/robt, which no node writes; did you mean 'truth/robot'?"),
        ("Plain", [], "nodes.own: Plain.writes: 'count' is 3; expected a type of messages"),
        (
            "Uncompared",
            [],
            "nodes.own: Uncompared.writes: 'count' has compared=False; the outputs of a node are always",
        ),
    ],
)
def test_what_is_no_node_is_told_before_a_run(room: Any, name: str, settings: list[str], told: str) -> None:
    with pytest.raises(ScenarioError) as error:
        build_node(room(name, *settings), "own")
    assert str(error.value).startswith(told)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Twice", "returned a Count, which 2 of its topics carry; it writes one, other; return (topic, message)"),
        ("Forgetful", "step returned a state of type NoneType; expected State"),
        ("Loud", "returned messages for elsewhere, which it does not declare"),
        ("Untyped", "count: Count: Expected `int`, got `str` - at `$.seen`"),
    ],
)
def test_what_a_step_may_not_return_ends_the_run_with_the_node_s_name(room: Any, name: str, told: str) -> None:
    with pytest.raises(StepError, match="own failed in step 0, tick 0") as error:
        run_inline(plan_of(room(name)), [])
    assert told in str(error.value)
