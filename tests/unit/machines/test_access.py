"""What the generated access rules allow: all that the machines of a run do, and nothing in another's name."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import pytest
import zenoh
from dynpf_protocol.keys import ALIVE, DATA, OBSERVER, OPERATOR, RECORDER, SCENARIO, data_key
from dynpf_protocol.topics import TOPICS
from dynpf_runtime.bus.access import PLAYER, Grant, access_control, grants
from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.effects import Ask, Count, Declare, Effect, Put, Subscribe, Watch
from dynpf_runtime.machines.events import Answered, Counted, Event, Now, Started
from dynpf_runtime.machines.node_host import NodeHost
from dynpf_runtime.plan import Plan
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario, scenario_files
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from tests.unit.machines.conftest import Simulate
from tests.unit.machines.simulated_run import Still
from tests.unit.services.small_log import FACTS
from tests.unit.services.toy_nodes import ToyNode, spec_of


def within(key: str, allowed: Sequence[str]) -> bool:
    """Zenoh's own word on whether one of the expressions covers all of ``key``."""
    return any(zenoh.KeyExpr(one).includes(zenoh.KeyExpr(key)) for one in allowed)


def is_granted(effect: Effect, grant: Grant) -> bool:
    match effect:
        case Put(key):
            return within(key, grant.puts)
        case Subscribe(key):
            return within(key, grant.subscribes)
        case Declare(key):
            return within(key, grant.tokens)
        case Watch(key) | Count(key):
            return within(key, grant.watches)
        case Ask(key):
            return within(key, grant.asks)
    return True


def joining(name: str, plan: Plan) -> Iterator[Effect]:
    """All that the process of a node does on the bus until it is alive, and the messages that its node declares."""
    host = NodeHost(name, ToyNode(name), plan, "boot", endpoint="", log=[], gauges=Still())
    nobody = Counted(f"{ALIVE}{name}/*", ())
    events: list[Event] = [Started(), Answered(plan.text.encode()), nobody, nobody]
    for event in events:
        yield from host.handle(event, Now(0, 0))
    for row in plan.graph.specs[name].writes.values():
        yield Put(data_key(row.name, name), b"")
    for topic in (f"event/{name}", f"snapshot/{name}", "log", "notice", "diagnostics"):
        yield Put(data_key(topic, name), b"")
    for topic in plan.graph.acts if name == plan.graph.source else ():
        yield Put(data_key(topic, name), b"")


@pytest.mark.parametrize("path", scenario_files(), ids=lambda path: path.stem)
def test_every_process_of_every_scenario_may_do_what_it_declares_and_no_more(path: Path) -> None:
    scenario = load_scenario(str(path))
    if scenario.needs_log:
        scenario = load_scenario(str(path), log=FACTS)
    plan = plan_of(scenario)
    granted = grants(plan.graph)
    for name in plan.graph.nodes:
        effects = [
            effect for effect in joining(name, plan) if not isinstance(effect, Put) or effect.key.startswith(DATA)
        ]
        assert [effect for effect in effects if not is_granted(effect, granted[name])] == []
        subscribed = {effect.key for effect in effects if isinstance(effect, Subscribe)}
        assert {*granted[name].subscribes} == subscribed
        records = (
            {f"{DATA}**/{row}" for row in TOPICS if row.startswith("log/")} if name == plan.graph.source else set()
        )
        said = {effect.key for effect in effects if isinstance(effect, Put)}
        assert {key for key in granted[name].puts if key.startswith(DATA)} - records == said


def test_the_source_alone_may_say_what_is_in_a_log_of_any_robots_also_what_no_node_reads() -> None:
    plan = plan_of(load_scenario("landmark-team", log=FACTS))
    granted = grants(plan.graph)
    for topic in ("log/truth", "r1/log/truth", "r9/log/odometry"):
        speakers = [name for name, grant in granted.items() if name != PLAYER and within(DATA + topic, grant.puts)]
        assert speakers == [plan.graph.source]
    assert not within(f"{DATA}r1/log/truth/more", granted[plan.graph.source].puts)


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_whole_run_does_nothing_that_is_not_granted(clock: str, tmp_path: Path, simulate: Simulate) -> None:
    plan = plan_of(load_scenario("landmark-room", overrides=["max_ticks=12", f"clock={clock}"]))
    simulation = simulate(plan, tmp_path / "run.mcap")
    simulation.run(until=lambda: simulation.published[f"{DATA}controller/command"] >= 5)
    simulation.ask_to_stop("estimator", "enough")
    simulation.run()
    assert set(simulation.ended.values()) == {None}
    granted = grants(plan.graph)
    done = [(one.process, one.what) for one in simulation.story if one.process != "router"]
    kinds = (Put, Subscribe, Declare, Watch, Count, Ask)
    assert {type(effect) for _, effect in done}.issuperset(kinds)
    assert [one for one in done if isinstance(one[1], kinds) and not is_granted(one[1], granted[one[0]])] == []
    # The control: with the rights of the node after it, each does something that is not granted.
    names = plan.graph.nodes
    swapped = dict(zip(names, (*names[1:], names[0]), strict=True))
    for name in names:
        own = [effect for process, effect in done if process == name and isinstance(effect, kinds)]
        assert not all(is_granted(effect, granted[swapped[name]]) for effect in own)


NAMES = st.sampled_from(["a", "b", "r1/a", "r1/b", "r2/a", "log_reader", "stop", "recorded"])


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    """Nodes of any names that write topics of their own and read any."""
    names = draw(st.lists(NAMES, min_size=1, max_size=5, unique=True))
    topics = {name: [f"{name}/x", f"{name}/y"][: draw(st.integers(0, 2))] for name in names}
    every = [topic for own in topics.values() for topic in own] + ["log", *list(TOPICS)[:3]]
    reads = {name: draw(st.lists(st.sampled_from(every), max_size=3, unique=True)) for name in names}
    rows = {topic: structs.replace(TOPICS["truth/robot"], name=topic) for own in topics.values() for topic in own}
    return Graph(
        [
            spec_of(ToyNode(name))._replace(
                reads={topic: topic for topic in reads[name]}, writes={topic: rows[topic] for topic in topics[name]}
            )
            for name in names
        ]
    )


def overlapping(one: Sequence[str], other: Sequence[str]) -> set[str]:
    return {a for a in one for b in other if zenoh.KeyExpr(a).intersects(zenoh.KeyExpr(b))}


@settings(max_examples=60, deadline=None)
@given(graph=graphs())
def test_no_two_processes_may_say_the_same_and_all_that_is_read_may_be_said_and_heard(graph: Graph) -> None:
    granted = grants(graph)
    speakers = [name for name in granted if name != PLAYER]
    for one, other in combinations(speakers, 2):
        assert overlapping(granted[one].puts, granted[other].puts) == set()
        assert overlapping(granted[one].tokens, granted[other].tokens) == set()
    assert granted[OBSERVER].puts == granted[OBSERVER].tokens == ()
    for name, spec in graph.specs.items():
        for topic in spec.reads:
            writers = [
                other for other in graph.nodes if topic in [row.name for row in graph.specs[other].writes.values()]
            ]
            for writer in {*writers} - {name}:
                assert within(data_key(topic, writer), granted[writer].puts)
                assert within(data_key(topic, writer), granted[name].subscribes)
        for key in granted[name].puts:
            assert within(key, granted[RECORDER].subscribes)


def test_the_routers_table_denies_by_default_and_names_no_one_without_a_certificate() -> None:
    granted = grants(plan_of(load_scenario("landmark-room")).graph)
    names = {name: f"{name}@1" if name == "estimator" else name for name in granted if name not in (PLAYER, OPERATOR)}
    table = access_control(granted, names)
    assert (table["enabled"], table["default_permission"]) == (True, "deny")
    subjects = {one["id"]: one["cert_common_names"] for one in table["subjects"]}
    assert subjects["estimator"] == ["estimator@1"]
    assert not {PLAYER, OPERATOR} & subjects.keys()
    assert all(names for names in subjects.values())  # Zenoh: an empty list matches nobody
    used = [rule for policy in table["policies"] for rule in policy["rules"]]
    assert sorted(used) == sorted(rule["id"] for rule in table["rules"])
    assert all(rule["key_exprs"] and rule["permission"] == "allow" for rule in table["rules"])
    (asked,) = [rule for rule in table["rules"] if rule["id"] == "sensors asks"]
    assert (asked["flows"], asked["messages"], asked["key_exprs"]) == (["ingress"], ["query"], [SCENARIO])
