"""Runs of which everything was killed, and that go on from their recordings: the same bytes as if undisturbed."""

from contextlib import ExitStack
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.info import restarts
from dynpf_formats.recording.reader import load, read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry
from dynpf_protocol.keys import RECORDER
from dynpf_runtime import snapshot
from dynpf_runtime.plan import Plan
from dynpf_runtime.simulation import Simulation
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

from tests.unit.machines.recovering import NETWORK, PATIENCE_NS
from tests.unit.machines.simulated_run import simulated

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=30", "estimator.n=10", "state_digest_ticks=2"])
PLAN = plan_of(SCENARIO)
LIMIT_NS = 60 * 10**9


@pytest.fixture(name="undisturbed", scope="module")
def content_of_an_undisturbed_run(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("undisturbed") / "run.mcap"
    record_inline(SCENARIO, path)
    return content_digest(read_recording(path))


def run_until_killed(plan: Plan, path: Path, seed: int, happenings: int) -> None:
    """Kill everything after so many events and effects of a run."""
    with ExitStack() as files:
        simulation = simulated(files, plan, path, seed, network=NETWORK, patience_ns=PATIENCE_NS)
        simulation.run(until=lambda: len(simulation.story) >= happenings, limit_ns=LIMIT_NS)
        for name in simulation.processes:
            simulation.kill(name)
        left = path.read_bytes()
    path.write_bytes(left)  # nobody has closed the recording


def stop_and_kill(plan: Plan, path: Path, ended: int | None) -> None:
    """Stop a run, and kill everything when so many nodes have made their last step, or never."""
    with ExitStack() as files:
        simulation = simulated(files, plan, path, 1, network=NETWORK, patience_ns=PATIENCE_NS)
        simulation.run(until=lambda: len(simulation.story) >= 900, limit_ns=LIMIT_NS)
        simulation.ask_to_stop(plan.graph.source, "dynpf run, which had started it, was killed")
        simulation.run(limit_ns=LIMIT_NS)
    stopped = read_recording(path)
    assert stopped.end is not None
    assert stopped.end.stopped
    if ended is None:
        return
    left = path.with_name("left.mcap")
    with RecordingWriter(left, stopped.header, stopped.attachments) as writer:
        last = 0
        for one in stopped.records:
            envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
            writer.message(one.topic, envelope, one.payload)
            last += one.topic.startswith(JOURNAL_PREFIX) and decode_entry(one.payload).last
            if last == ended:
                break
        writer.close(complete=False, reason="killed")
    left.replace(path)


def resume(plan: Plan, path: Path, seed: int) -> Simulation:
    with ExitStack() as files:
        simulation = simulated(files, plan, path, seed, network=NETWORK, patience_ns=PATIENCE_NS, resume=True)
        simulation.run(until=lambda: simulation.ended.get(RECORDER, "runs") is None, limit_ns=LIMIT_NS)
    return simulation


@pytest.mark.parametrize("often", [False, True])
@pytest.mark.parametrize("part", range(5))
def test_everything_is_killed_and_the_run_goes_on_from_its_recording(
    part: int, often: bool, tmp_path: Path, undisturbed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if often:
        monkeypatch.setattr(snapshot, "_OFTEN", 1)
        monkeypatch.setattr(snapshot, "_SENT_PER_BYTE", 0)
        monkeypatch.setattr(snapshot, "_FIRST_SENT_PER_BYTE", 0)
    path = tmp_path / "run.mcap"
    run_until_killed(PLAN, path, part, 300 + 350 * part)
    assert load(path)[0].end is None
    resume(PLAN, path, part)
    recording = read_recording(path)
    assert recording.end is not None
    assert (recording.end.complete, recording.end.reason) == (True, "finished")
    assert content_digest(recording) == undisturbed
    assert {told.node for told in restarts(recording)} == {RECORDER, *PLAN.graph.nodes}
    assert main(["doctor", str(path)]) == 0
    assert main(["replay", str(path)]) == 0


@pytest.mark.parametrize("runner", ["bus", "inline"])
@pytest.mark.parametrize("ended", [1, 2, 4, None])
def test_a_run_that_was_being_stopped_when_all_was_killed_goes_on_beyond_the_tick_that_was_to_be_its_last(
    ended: int | None, runner: str, tmp_path: Path, undisturbed: str
) -> None:
    path = tmp_path / "run.mcap"
    stop_and_kill(PLAN, path, ended)
    if runner == "bus":
        simulation = resume(PLAN, path, 3)
        told = [text for name in simulation.processes for text in simulation.notices(name)]
        assert not [text for text in told if "refused" in text]
        assert any("recorder is back" in text for text in told)
    else:
        assert main(["resume", str(path), "--runner", "inline", "--no-page"]) == 0
    recording = read_recording(path)
    assert recording.end is not None
    assert (recording.end.complete, recording.end.outcome) == (True, "budget spent")
    assert content_digest(recording) == undisturbed
    assert main(["doctor", str(path)]) == 0
