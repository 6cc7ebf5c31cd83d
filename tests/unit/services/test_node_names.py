"""Several nodes of a kind and several robots in a run: what nodes and their topics are called, and what is refused."""

from typing import Any

import pytest
from dynpf_formats.shipped import known_topics
from dynpf_protocol.errors import ScenarioError
from dynpf_runtime.graph import Graph
from dynpf_services.scenario.build import build_nodes, plan_of
from dynpf_services.scenario.load import override_resolved, parse_scenario
from dynpf_services.scenario.schema import resolved_json

ESTIMATOR: dict[str, object] = {"kind": "localization", "measurement": "range_bearing"}
ROBOT: dict[str, dict[str, object]] = {
    "simulator": {"kind": "room"},
    "sensors": {"kind": "simulated", "odometry": {}, "landmarks": {}},
    "estimator": ESTIMATOR,
    "controller": {"kind": "waypoints", "points": [[1.0, 0.0]]},
}
RUN = {"title": "A room", "landmarks": [{"id": 1, "x": 0.0, "y": 1.0}]}


def graph(**tables: Any) -> Graph:
    """Return the graph of a scenario, which is that of its resolved text as well."""
    scenario = parse_scenario({**RUN, **tables}, "run.toml")
    again = override_resolved(resolved_json(scenario), (), "run.toml")
    assert again == scenario
    found = plan_of(scenario).graph
    assert plan_of(again).graph.nodes == found.nodes
    return found


def test_a_second_node_of_a_kind_reads_what_the_first_does_and_writes_under_its_own_name() -> None:
    specs = graph(**ROBOT, nodes={"other": ESTIMATOR}).specs
    usual, other = specs["estimator"], specs["other"]
    assert other.kind == usual.kind
    assert {own: row.name for own, row in usual.writes.items()} == {own: own for own in usual.writes}
    assert {own: row.name for own, row in other.writes.items()} == {
        own: own.replace("estimator/", "other/") for own in usual.writes
    }
    assert {own: row.type for own, row in other.writes.items()} == {
        own: known_topics()[own].type for own in usual.writes
    }
    shared = set(usual.reads) - {"event/estimator"}
    assert {"sensors/odometry", "sensors/landmarks"} <= shared
    assert other.reads == {**{topic: topic for topic in shared}, "event/other": "event/estimator"}
    assert specs["controller"].reads == {"estimator/state": "estimator/state"}  # of the first, as without the other


def test_each_robot_has_nodes_and_topics_of_its_own() -> None:
    found = graph(robots=["r1", "r2"], robot=ROBOT)
    kinds = ("simulator", "sensors", "estimator", "controller")
    assert found.nodes == tuple(f"{robot}/{kind}" for kind in kinds for robot in ("r1", "r2"))
    alone = graph(**ROBOT)
    for name, spec in found.specs.items():
        robot, _, kind = name.partition("/")
        usual = alone.specs[kind]
        events = {"event/estimator": f"event/{name}"}
        assert spec.reads == {events.get(own, f"{robot}/{own}"): own for own in usual.reads}
        assert {own: row.name for own, row in spec.writes.items()} == {
            own: own if own == "log" else f"{robot}/{own}" for own in usual.writes
        }
    waits = {name: {other for other in lags if other[:2] != name[:2]} for name, lags in found.lags.items()}
    source, second = "r1/simulator", "r2/simulator"
    assert {name: others for name, others in waits.items() if others} == {
        source: {"r2/controller"},  # it begins the ticks of all
        second: {source},
    }


def test_a_robot_may_have_nodes_of_ones_own_names_and_the_run_others_beside_the_robots() -> None:
    found = graph(robots=["r1"], robot={**ROBOT, "other": ESTIMATOR}, nodes={"above": {**ESTIMATOR, "remap": REMAP}})
    other, above = found.specs["r1/other"], found.specs["above"]
    assert other.writes["estimator/state"].name == "r1/other/state"
    assert other.reads["r1/sensors/odometry"] == "sensors/odometry"
    assert above.writes["estimator/state"].name == "above/state"
    assert above.reads["r1/sensors/odometry"] == "sensors/odometry"


REMAP = {"sensors/odometry": "r1/sensors/odometry", "sensors/landmarks": "r1/sensors/landmarks"}


def test_a_remap_changes_what_a_nodes_own_name_stands_for_and_nothing_else() -> None:
    table = {**ESTIMATOR, "remap": {"estimator/state": "second/best"}}
    found, usual = graph(**ROBOT, nodes={"other": table}), graph(**ROBOT, nodes={"other": ESTIMATOR})
    names = {own: row.name for own, row in found.specs["other"].writes.items()}
    assert names == {
        **{own: row.name for own, row in usual.specs["other"].writes.items()},
        "estimator/state": "second/best",
    }
    assert found.specs["other"].reads == usual.specs["other"].reads
    assert found.topics["second/best"].publishers == ("other",)
    driven = {**ROBOT["controller"], "remap": {"estimator/state": "other/state"}}
    found = graph(**{**ROBOT, "controller": driven}, nodes={"other": ESTIMATOR})
    assert found.specs["controller"].reads == {"other/state": "estimator/state"}
    assert found.lags["controller"] == {"other": 0}


RESERVED = "expected lower-case letters, digits and _, from a letter on, with / after the name of a robot"
KINDS = (
    "capsule_estimator, capsule_sensors, capsule_simulator, localization, log, rearrangement_controller, "
    "rearrangement_estimator, room, simulated, vision, waypoints, workspace, package.module:Name"
)


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        (
            {"nodes": {"other": {**ESTIMATOR, "remap": {"estimator/state": "estimator/state"}}}},
            "nodes.other: writes estimator/state, which estimator writes already",
        ),
        pytest.param(
            {"nodes": {"b": {**ESTIMATOR, "remap": {"estimator/pose": "x/y", "estimator/state": "x/y"}}}},
            "nodes.b: writes x/y",
        ),
        pytest.param(
            {"nodes": {"b": {**ESTIMATOR, "remap": {"sensors/odometry": "sensors/odometry_pose"}}}},
            "nodes.b",
        ),
        pytest.param(
            {"nodes": {"b": {**ESTIMATOR, "remap": {"estimator/stat": "x/y"}}}},
            "nodes.b",
        ),
        pytest.param(
            {"nodes": {"b": {**ESTIMATOR, "remap": {"estimator/state": "A b"}}}},
            "nodes.b",
        ),
        (
            {"nodes": {"other": {**ESTIMATOR, "remap": {"estimator/state": "log/odometry"}}}},
            "nodes.other: writes log/odometry, which nodes must not write",
        ),
        (
            {"nodes": {"other": {**ESTIMATOR, "remap": {"estimator/state": "journal/other"}}}},
            "nodes.other: writes journal/other, which nodes must not write",
        ),
        (
            {"nodes": {"other": {**ESTIMATOR, "remap": {"sensors/landmarks": "sensor/landmarks"}}}},
            "nodes.other.measurement: reads sensor/landmarks, which no node of this run writes",
        ),
        (
            {"nodes": {"other": {**ESTIMATOR, "remap": {"estimator/state": 3}}}},
            "run.toml: nodes.other.remap: {'estimator/state': 3}; expected topics by the node's own names for them",
        ),
        (
            {"nodes": {"other": {"kind": "localisation"}}},
            f"run.toml: nodes.other.kind: 'localisation'; expected one of {KINDS}; did you mean 'localization'?",
        ),
        ({"nodes": {"other": {}}}, f"run.toml: nodes.other.kind: missing; expected one of {KINDS}"),
        ({"nodes": {"other": {**ESTIMATOR, "nn": 3}}}, "run.toml: nodes.other.nn: unknown key; did you mean 'n'?"),
        (
            {"nodes": {"other": ESTIMATOR}, "other": {"n": 3}},
            "run.toml: other: unknown key; did you mean 'nodes.other'?",
        ),
        *(
            (
                {"nodes": {name: ESTIMATOR}},
                f"run.toml: nodes: {name!r} is no name for a node; {RESERVED}; {name!r} is reserved",
            )
            for name in ("estimator", "log", "recorder", "router", "event", "journal", "diagnostics", "truth", "camera")
        ),
        *(
            ({"nodes": {name: ESTIMATOR}}, f"run.toml: nodes: {name!r} is no name for a node; {RESERVED}")
            for name in ("Other", "a b", "1st", "a//b", "/a", "a/", "")
        ),
        ({"robots": "r1", "robot": ROBOT}, "run.toml: robots: 'r1'; expected a list of names, such as ['r1', 'r2']"),
        ({"robots": ["R 1"], "robot": ROBOT}, "run.toml: robots: ['R 1']; expected a list of names"),
        pytest.param(
            {"robots": ["r1", "r1"], "robot": ROBOT},
            "run.toml: robots: ",
        ),
        ({"robots": ["r1"]}, "run.toml: robot: missing; expected the tables of the nodes that each robot has"),
    ],
)
def test_names_that_cannot_be_are_refused_in_one_line(tables: dict[str, Any], told: str) -> None:
    with pytest.raises(ScenarioError) as error:
        build_nodes(parse_scenario({**RUN, **ROBOT, **tables}, "run.toml"))
    assert str(error.value).startswith(told)
    assert "\n" not in str(error.value)
