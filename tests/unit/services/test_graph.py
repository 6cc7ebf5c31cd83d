from pathlib import Path

import pytest
from dynpf_protocol.topics import TOPICS
from dynpf_runtime.graph import Graph, topic_table
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario, scenario_files
from msgspec import structs

from tests.unit.services.small_log import FACTS
from tests.unit.services.toy_nodes import ToyNode, graph_of, spec_of

FULL = (
    ToyNode("simulator", ["controller/command"], ["truth/robot", "camera/image", "log"]),
    ToyNode("vision", ["camera/image"], ["vision/detections"]),
    ToyNode("sensors", ["truth/robot"], ["sensors/gripper"]),
    ToyNode("estimator", ["vision/detections", "sensors/gripper", "controller/command"], ["estimator/state"]),
    ToyNode("controller", ["estimator/state"], ["controller/command", "log"]),
)


def test_the_first_node_is_the_source() -> None:
    graph = graph_of(FULL)
    assert graph.nodes == ("simulator", "vision", "sensors", "estimator", "controller")
    assert graph.source == "simulator"


def test_what_stands_before_a_node_is_read_now_and_what_stands_behind_it_a_tick_later() -> None:
    assert graph_of(FULL).lags == {
        "simulator": {"controller": 1},
        "vision": {"simulator": 0},
        "sensors": {"simulator": 0},
        "estimator": {"vision": 0, "sensors": 0, "controller": 1},
        "controller": {"estimator": 0},
    }


def test_writers_that_take_no_part_are_not_waited_for() -> None:
    graph = graph_of([ToyNode("sensors", reads=["log/odometry"]), ToyNode("estimator", reads=["vision/detections"])])
    assert graph.source == "sensors"
    assert graph.lags == {"sensors": {"estimator": 1}, "estimator": {"sensors": 0}}


@pytest.mark.parametrize("reads", [[], ["controller/command"], ["event/estimator"]])
def test_a_node_that_reads_nothing_from_before_it_has_the_tick_from_the_source(reads: list[str]) -> None:
    controller = ToyNode("controller", writes=["controller/command"])
    graph = graph_of([ToyNode("simulator"), ToyNode("estimator", reads=reads), controller])
    assert graph.lags["estimator"]["simulator"] == 0


@pytest.mark.parametrize("path", scenario_files(), ids=lambda path: path.stem)
def test_in_every_scenario_all_wait_for_the_source_and_it_for_all(path: Path) -> None:
    scenario = load_scenario(str(path))
    if scenario.needs_log:
        scenario = load_scenario(str(path), log=FACTS)
    graph = plan_of(scenario).graph
    ended = set(graph.lags[graph.source])
    for node in reversed(graph.nodes[1:]):  # who has ended a tick has seen the end of all that it waits for in it
        if node in ended:
            ended |= {upstream for upstream, lag in graph.lags[node].items() if lag == 0}
    assert ended | {graph.source} == set(graph.nodes)
    reached = {graph.source}
    for node in graph.nodes[1:]:
        assert any(lag == 0 and upstream in reached for upstream, lag in graph.lags[node].items())
        reached.add(node)


def test_inputs_are_ordered_by_topic_table_sender_and_sequence() -> None:
    order = [
        ("log/odometry", "log", 9),
        ("truth/robot", "simulator", 10),
        ("truth/robot", "simulator", 11),
        ("estimator/state", "estimator", 0),
        ("log", "simulator", 5),
        ("log", "controller", 0),
    ]
    backwards = order[::-1]
    assert sorted(backwards, key=lambda one: graph_of(FULL).input_order(*one)) == order


def test_a_run_has_the_topics_of_its_nodes_of_logs_and_of_hosts_each_with_who_sends_it() -> None:
    other = structs.replace(TOPICS["estimator/state"], name="other/state")
    specs = [*map(spec_of, FULL), spec_of(ToyNode("other"))._replace(writes={"estimator/state": other})]
    publishers = {name: row.publishers for name, row in topic_table(specs).items() if not name.startswith("log/")}
    nodes = ("simulator", "vision", "sensors", "estimator", "controller", "other")
    # In the order of the table: what has a name of its own stands where it would with its usual one. Topics of systems
    # follow, in the order of their nodes.
    assert list(publishers.items()) == [
        ("truth/robot", ("simulator",)),
        ("estimator/state", ("estimator",)),
        ("other/state", ("other",)),
        ("controller/command", ("controller",)),
        ("camera/image", ("simulator",)),
        ("vision/detections", ("vision",)),
        ("sensors/gripper", ("sensors",)),
        *((f"{kind}/{node}", (node,)) for node in nodes for kind in ("event", "snapshot")),
        ("log", (*nodes, "recorder")),
        ("notice", nodes),
        ("diagnostics", nodes),
        ("recorder/gap", ("recorder",)),
        ("recorder/restart", ("recorder",)),
    ]


def test_the_records_that_begin_a_tick_are_those_that_are_read_and_wake() -> None:
    robot = spec_of(ToyNode("r1/sensors"))._replace(
        reads={"r1/log/odometry": "log/odometry", "r1/log/truth": "log/truth"}
    )
    graph = Graph([spec_of(ToyNode("sensors", reads=["log/scan", "log/truth"])), robot])
    assert graph.waking_records == {"log/scan", "r1/log/odometry"}
    assert graph.topics["r1/log/odometry"].publishers == ("log",)
    # The source feeds in all records, those of other robots too.
    assert graph.lags["r1/sensors"] == {"sensors": 0}


def test_a_node_subscribes_to_what_it_reads_and_another_writes() -> None:
    both = ToyNode("estimator", ["truth/robot", "estimator/state", "sensors/scan"], ["estimator/state"])
    assert graph_of([FULL[0], both]).subscribed("estimator") == ["truth/robot"]
