"""The order of a tick: by stage, within one each node behind those that it reads, else as declared."""

from dynpf_protocol.messages import Command
from dynpf_protocol.topics import Topic
from dynpf_runtime.graph import NodeSpec
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import parse_scenario
from dynpf_services.scenario.order import in_tick_order
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.services.toy_nodes import ToyNode


def spec(name: str, *upstream: str) -> NodeSpec:
    """Return a node that writes NAME/out and reads what the nodes ``upstream`` write."""
    row = Topic(name=f"{name}/out", type=Command, publishers=(name,), description="Made up")
    reads = {f"{other}/out": f"{other}/out" for other in upstream}
    return NodeSpec(name, name, lambda: ToyNode(name), reads, {"out": row})


def order(*nodes: str, **stages: int) -> str:
    """Return the order of nodes of one letter: ``"b:a"`` is a node b that reads a; the others have no stage."""
    specs = [spec(text[0], *text[2:]) for text in nodes]
    return "".join(one.name for one in in_tick_order(specs, {one.name: stages.get(one.name) for one in specs}))


def test_stages_go_before_the_order_of_declaration_and_before_what_is_read() -> None:
    assert order("c", "b", "a", a=0, b=1, c=2) == "abc"
    assert order("a:c", "b", "c:b", a=0, b=1, c=2) == "abc"


def test_several_of_one_stage_keep_the_order_of_their_declaration() -> None:
    assert order("s", "z", "m", "a", s=0, z=3, m=3, a=3) == "szma"


def test_in_a_stage_a_node_follows_those_that_it_reads() -> None:
    assert order("s", "a:b", "b:c", "c", s=0, a=3, b=3, c=3) == "scba"
    # Only those wait that read: d was declared before b and c.
    assert order("s", "a:b", "d", "b", s=0, a=3, d=3, b=3) == "sdba"


def test_a_node_that_reads_itself_waits_for_nobody() -> None:
    assert order("a:a", "b", a=1, b=1) == "ab"


def test_a_node_without_a_stage_has_its_turn_between_what_it_reads_and_the_next_stage() -> None:
    assert order("u:b", "a", "b:a", "c:u", a=0, b=1, c=2) == "abuc"
    assert order("u:ab", "a", "b:a", "c", a=0, b=1, c=2) == "abuc"  # behind the last of those that it reads
    assert order("u:a", "a", "b", a=0, b=1) == "aub"


def test_nodes_without_a_stage_that_read_each_other_in_a_row_follow_each_other() -> None:
    assert order("w:v", "v:u", "u:a", "a", "b", a=0, b=1) == "auvwb"


def test_a_node_without_a_stage_waits_for_all_that_it_reads_not_for_the_first_alone() -> None:
    assert order("u:av", "v:b", "a", "b", a=0, b=2) == "abvu"


def test_a_node_without_a_stage_that_reads_nothing_comes_behind_the_source() -> None:
    assert order("u", "a", "b", a=0, b=1) == "aub"


def test_of_a_circle_the_first_declared_comes_first() -> None:
    assert order("s", "a:b", "b:a", s=0, a=3, b=3) == "sab"
    assert order("s", "b:a", "a:b", s=0, a=3, b=3) == "sba"
    assert order("s", "a:sb", "b:a", s=0) == "sab"  # without stages too
    assert order("s", "x:y", "y:x", s=0) == "sxy"  # even where neither reads a node that has one


def test_who_only_reads_a_circle_comes_behind_it() -> None:
    assert order("s", "c:b", "a:b", "b:a", s=0, c=3, a=3, b=3) == "sabc"


def test_a_topic_that_nobody_writes_holds_nobody_up() -> None:
    assert order("a:z", "b", a=0, b=0) == "ab"


@settings(derandomize=True, deadline=None, max_examples=200)
@given(data=st.data(), names=st.permutations("abcdef"))
def test_of_nodes_without_circles_none_comes_before_one_of_its_stage_or_an_earlier_one_that_it_reads(
    data: st.DataObject, names: list[str]
) -> None:
    stages = data.draw(st.lists(st.integers(0, 2) | st.none(), min_size=6, max_size=6))
    of = dict(zip(names, stages, strict=True))
    upstream = {
        name: data.draw(st.sets(st.sampled_from(names[:rank]))) if rank else set() for rank, name in enumerate(names)
    }
    declared = data.draw(st.permutations(names))
    placed = [one.name for one in in_tick_order([spec(name, *sorted(upstream[name])) for name in declared], of)]
    assert sorted(placed) == sorted(names)
    staged = [stage for name in placed if (stage := of[name]) is not None]
    assert staged == sorted(staged, key=int)
    for name in names:
        own = of[name]
        for writer in upstream[name]:
            stage = of[writer]
            if own is None or (stage is not None and stage <= own):
                assert placed.index(writer) < placed.index(name), (placed, name, writer)


def test_a_runs_nodes_are_in_tick_order_however_they_are_declared() -> None:
    tables = {
        "controller": {"kind": "waypoints", "points": [[1.0, 0.0]]},
        "estimator": {"kind": "localization", "measurement": "range_bearing"},
        "sensors": {"kind": "simulated", "odometry": {}, "landmarks": {}},
        "simulator": {"kind": "room"},
    }
    rest = {"title": "A room", "landmarks": [{"id": 1, "x": 0.0, "y": 1.0}]}
    for order in (list(tables), list(tables)[::-1]):
        scenario = parse_scenario({**rest, **{name: tables[name] for name in order}}, "")
        assert plan_of(scenario).graph.nodes == ("simulator", "sensors", "estimator", "controller")
    two = {"second": tables["estimator"], "first": tables["estimator"]}
    scenario = parse_scenario({**rest, **tables, "nodes": two}, "")
    nodes = plan_of(scenario).graph.nodes
    assert nodes == ("simulator", "sensors", "estimator", "second", "first", "controller")
