"""Inline and replay runners on small runs."""

from pathlib import Path
from typing import Any

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import StepError
from dynpf_protocol.journal import encode_entry
from dynpf_protocol.messages import Diagnostics
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.graph import Graph
from dynpf_runtime.inbox import Ready
from dynpf_runtime.inline import run_inline
from dynpf_runtime.node import Result, Step
from dynpf_runtime.plan import run_header
from dynpf_runtime.replay import replay_node, write_replayed
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

from tests.unit.recording.recorded_runs import NODELESS
from tests.unit.services.toy_nodes import IDLE, ToyNode, executor_of, graph_of, received, says, spec_of


def test_a_node_that_raises_ends_an_inline_run_by_name(tmp_path: Path) -> None:
    def act(step: Step) -> Result:
        if step.tick == 3:
            raise IndexError("out of it")
        return Result()

    graph = graph_of([ToyNode("simulator"), ToyNode("controller", act=act)])
    plan = plan_of(load_scenario("landmark-room"))._replace(graph=graph)
    path = tmp_path / "run.mcap"
    with (
        pytest.raises(StepError, match=r"controller failed in step 3, tick 3: IndexError: out of it \(.*\.py:\d+\)"),
        RecordingWriter(path, run_header(plan)) as writer,
    ):
        run_inline(plan, [], writer)
    end = read_recording(path).end  # what came before is kept
    assert end is not None
    assert (end.complete, end.counts) == (False, {"journal/controller": 3, "journal/simulator": 4})


def test_the_scenarios_limit_of_ticks_ends_an_inline_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    assert main(["run", "landmark-room", "--runner", "inline", "--set", "max_ticks=12", "-o", str(path)]) == 0
    recording = read_recording(path)
    assert recording.end is not None
    assert recording.end.counts["truth/robot"] == 12
    assert recording.end.counts["journal/estimator"] == 12
    assert main(["replay", str(path)]) == 0


def test_a_replayed_recording_keeps_what_the_host_told_the_node(tmp_path: Path) -> None:
    node: Any = ToyNode(
        "controller",
        reads=["sensors/odometry", "event/controller"],
        writes=["controller/command"],
        act=lambda _: says("controller/command", IDLE),
    )
    executor, watch = executor_of(node, "c1", 2), GapWatch()
    with RecordingWriter(tmp_path / "run.mcap", NODELESS) as writer:
        for tick, sequence in enumerate((0, 2, 3)):  # number 1 is lost on the way
            one = received("sensors/odometry", "sensors", sequence, tick * 10)
            place = Envelope(one.node, one.boot, one.sequence, tick, one.stamp_ns, 0)
            writer.message(one.topic, place, encode(one.topic, one.message))
            ready = Ready(tick, tick * 10, [one], False)
            events = notice_gaps(executor, watch, ready, tick * 10, 0)
            sent = executor.step(tick, tick * 10, ready.inputs, 0).sent
            beat = Diagnostics(node="controller", steps=tick, step_time_s=0.1, refused={}, queue=0)
            for message in (*events, *sent, executor.stamp("diagnostics", beat, tick, tick * 10, 0)):
                writer.message(*message)
            entry = executor.journal(tick, tick * 10, ready.inputs, sent, hosted=events, last=tick == 2)
            writer.journal(Envelope("controller", "c1", tick, tick, tick * 10, 0), encode_entry(entry))
        before = writer.close(complete=True, reason="finished")
    assert before.counts["event/controller"] == 1
    assert before.counts["recorder/gap"] == 1

    recording = read_recording(tmp_path / "run.mcap")
    again = ToyNode("controller", node.reads, node.writes, act=lambda _: says("controller/command", IDLE))
    sensors = ToyNode("sensors", writes=["sensors/odometry"])
    plan = plan_of(load_scenario("landmark-room"))._replace(graph=graph_of([sensors, again]), state_digest_ticks=2)
    outcome = replay_node(recording, plan, "controller", keep=True)
    assert outcome.mismatch is None
    assert (outcome.steps, outcome.digests) == (3, 2)
    with RecordingWriter(tmp_path / "again.mcap", NODELESS) as writer:
        write_replayed(recording, [outcome], writer)
        after = writer.close(complete=True, reason="replayed")
    assert after.complete
    assert {**after.counts, "diagnostics": 3} == before.counts  # the timings of the old process go
    assert (after.gaps, after.missing, after.duplicates) == (before.gaps, 1, 0)


def test_a_replayed_node_that_does_something_else_is_caught(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    scenario = load_scenario("landmark-room", overrides=["max_ticks=5"])
    record_inline(scenario, path)
    node = ToyNode(
        "controller", ["estimator/state"], ["controller/command"], act=lambda _: says("controller/command", IDLE)
    )
    plan = plan_of(scenario)
    estimator = plan.graph.specs["estimator"]
    plan = plan._replace(graph=Graph([estimator, spec_of(node)]))
    mismatch = replay_node(read_recording(path), plan, "controller").mismatch
    assert mismatch is not None
    assert (mismatch.node, mismatch.topic, mismatch.tick) == ("controller", "controller/command", 0)
