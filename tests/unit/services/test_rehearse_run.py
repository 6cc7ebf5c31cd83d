"""A run is rehearsed once a machine for each choice of nodes, and only what went through counts as rehearsed."""

from pathlib import Path

import pytest
from dynpf_runtime import rehearsal
from dynpf_runtime.node import Result, Step
from dynpf_runtime.rehearsal import rehearse_run
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

from tests.unit.services.toy_nodes import ToyNode, graph_of


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(rehearsal, "cache_folder", lambda: tmp_path)
    return tmp_path


def test_nodes_that_have_stepped_on_this_machine_are_not_rehearsed_again(folder: Path) -> None:
    steps: list[int] = []

    def act(step: Step) -> Result:
        steps.append(step.tick)
        return Result()

    plan = plan_of(load_scenario("landmark-room"))._replace(graph=graph_of([ToyNode("simulator", act=act)]))
    rehearse_run(plan, [])
    assert steps == [0, 1, 2, 3, 4]
    rehearse_run(plan, [])
    assert steps == [0, 1, 2, 3, 4]
    for marker in folder.iterdir():
        marker.unlink()
    rehearse_run(plan, [])
    assert len(steps) == 10


def test_a_node_that_fails_is_left_to_the_run_to_tell_and_counts_as_not_rehearsed(folder: Path) -> None:
    def act(_: Step) -> Result:
        raise IndexError("out of it")

    graph = graph_of([ToyNode("simulator", act=act)])
    rehearse_run(plan_of(load_scenario("landmark-room"))._replace(graph=graph), [])
    assert not list(folder.iterdir())
