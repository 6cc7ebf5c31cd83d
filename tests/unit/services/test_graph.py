import pytest
from dynpf_runtime.graph import Graph, input_order
from dynpf_services.scenario.build import build_nodes
from dynpf_services.scenario.load import load_scenario, scenario_files

from tests.unit.services.small_log import FACTS
from tests.unit.services.toy_nodes import ToyNode

FULL = (
    ToyNode("controller", reads=["estimator/state"]),
    ToyNode("estimator", reads=["vision/detections", "sensors/gripper", "controller/command"]),
    ToyNode("sensors", reads=["truth/robot"]),
    ToyNode("vision", reads=["camera/image"]),
    ToyNode("simulator", reads=["controller/command"]),
)


def test_a_tick_goes_round_in_one_order_however_the_nodes_are_given() -> None:
    graph = Graph.of(FULL)
    assert graph == Graph.of(FULL[::-1])
    assert graph.nodes == ("simulator", "vision", "sensors", "estimator", "controller")
    assert graph.source == "simulator"


def test_what_stands_before_a_node_is_read_now_and_what_stands_behind_it_a_tick_later() -> None:
    assert Graph.of(FULL).lags == {
        "simulator": {"controller": 1},
        "vision": {"simulator": 0},
        "sensors": {"simulator": 0},
        "estimator": {"vision": 0, "sensors": 0, "controller": 1},
        "controller": {"estimator": 0},
    }


def test_writers_that_take_no_part_are_not_waited_for() -> None:
    graph = Graph.of([ToyNode("sensors", reads=["log/odometry"]), ToyNode("estimator", reads=["vision/detections"])])
    assert graph.source == "sensors"
    assert graph.lags == {"sensors": {"estimator": 1}, "estimator": {"sensors": 0}}


@pytest.mark.parametrize("reads", [[], ["controller/command"], ["event/estimator"]])
def test_a_node_that_reads_nothing_from_before_it_has_the_tick_from_the_source(reads: list[str]) -> None:
    graph = Graph.of([ToyNode("simulator"), ToyNode("estimator", reads=reads), ToyNode("controller")])
    assert graph.lags["estimator"]["simulator"] == 0


@pytest.mark.parametrize("path", scenario_files(), ids=lambda path: path.stem)
def test_in_every_scenario_all_wait_for_the_source_and_it_for_all(path: object) -> None:
    scenario = load_scenario(str(path))
    if scenario.needs_log:
        scenario = load_scenario(str(path), log=FACTS)
    graph = Graph.of(list(build_nodes(scenario).values()))
    ended = set(graph.lags[graph.source])
    for node in reversed(graph.nodes[1:]):  # who has ended a tick has seen the end of all that it waits for in it
        if node in ended:
            ended |= {upstream for upstream, lag in graph.lags[node].items() if lag == 0}
    assert ended == set(graph.nodes)
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
    assert sorted(backwards, key=lambda one: input_order(*one)) == order
