"""Realtime runs whose processes are killed: the run goes on, tells what was missed, and replays exactly."""

import json
from collections import Counter
from pathlib import Path

import pytest
from dynpf_formats.recording.doctor import Finding, diagnosis
from dynpf_formats.recording.info import restarts
from dynpf_formats.recording.reader import load, read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.errors import RunError
from dynpf_protocol.keys import AGAIN, DATA, JOURNAL, RECORDER, ROUTER, SAID_BY
from dynpf_protocol.topics import EVENT_PREFIX
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.replay import replay_node
from dynpf_runtime.simulation import Network, Simulation
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

from tests.unit.machines.recovering import NETWORK, PATIENCE_NS, Kill, recovered
from tests.unit.machines.simulated_run import host_of

SETTINGS = ["estimator.n=10", "max_ticks=30", "state_digest_ticks=4"]
SCENARIO = load_scenario("landmark-room", overrides=SETTINGS, clock="realtime")
PLAN = plan_of(SCENARIO)
NODES = PLAN.graph.nodes
EVERYBODY = (ROUTER, RECORDER, *NODES)


@pytest.fixture(name="story", scope="module")
def story_of_an_undisturbed_run(tmp_path_factory: pytest.TempPathFactory) -> Simulation:
    return recovered(PLAN, tmp_path_factory.mktemp("undisturbed") / "run.mcap", 1, [])


def findings(path: Path) -> list[Finding]:
    return diagnosis(*load(path)).findings


def assert_whole(path: Path) -> None:
    recording = read_recording(path)
    assert recording.end is not None
    assert (recording.end.complete, recording.end.reason) == (True, "finished")
    assert findings(path) == []
    for name in NODES:
        outcome = replay_node(recording, PLAN, name)
        assert outcome.mismatch is None
        assert outcome.steps >= 20  # of 30; some pass while a process is gone


def gaps(path: Path, name: str) -> set[str]:
    """Return the topics of which a node's host has reported gaps."""
    return {json.loads(record.payload)["topic"] for record in read_recording(path).messages(EVENT_PREFIX + name)}


def happened(story: Simulation, name: str) -> int:
    return sum(one.process == name for one in story.story)


@pytest.mark.parametrize("name", EVERYBODY)
def test_a_realtime_run_goes_on_when_a_process_is_killed_anywhere(name: str, tmp_path: Path, story: Simulation) -> None:
    moments = 4
    for part in range(2 if name == ROUTER else 1, moments):  # of the router, once the run has begun
        path = tmp_path / f"{part}.mcap"
        network = NETWORK._replace(delay_ns=10 ** (5 + part % 3))
        recovered(PLAN, path, part, [Kill(name, part * happened(story, name) // moments)], network=network)
        assert_whole(path)
        assert [one.node for one in restarts(read_recording(path))] == [name]


def test_what_a_node_missed_is_told_and_what_it_did_stays(tmp_path: Path, story: Simulation) -> None:
    path, undisturbed = tmp_path / "run.mcap", tmp_path / "undisturbed.mcap"
    simulation = recovered(PLAN, path, 3, [Kill("estimator", happened(story, "estimator") // 2)])
    steps = [entry.step for entry in read_recording(path).journal("estimator", "estimator-1")]
    assert steps == list(range(len(steps)))
    assert {"sensors/odometry", "sensors/landmarks"} & gaps(path, "estimator")
    assert not gaps(path, "simulator") - {"controller/command"}
    recovered(PLAN, undisturbed, 3, [])
    assert gaps(undisturbed, "estimator") == set()
    assert main(["replay", str(path)]) == 0
    assert simulation.ended[RECORDER] is None


def test_a_steps_entry_goes_out_before_its_messages(story: Simulation) -> None:
    entered: Counter[str] = Counter()
    checked = 0
    for _, name, what in story.story:
        if isinstance(what, Put) and what.key == JOURNAL + name:
            entered[name] += 1
        elif isinstance(what, Put) and what.key.startswith(DATA) and name in NODES:
            envelope = decode_envelope(what.attachment)
            topic = what.key.removeprefix(DATA)
            if topic in {row.name for row in PLAN.graph.specs[name].writes.values()}:
                assert envelope.tick < entered[name]
                checked += 1
    assert checked > 100


@pytest.mark.parametrize("name", ["estimator", "simulator"])
def test_a_step_of_which_only_the_entry_was_said_is_done_again(name: str, tmp_path: Path, story: Simulation) -> None:
    """Without that, its messages would be lost, and those who have heard some would know of a step nobody has made."""
    own = [one.what for one in story.story if one.process == name]
    for more in (1, 2):
        entered = [at for at, what in enumerate(own) if isinstance(what, Put) and what.key == JOURNAL + name][12]
        path = tmp_path / f"{more}.mcap"
        recovered(PLAN, path, 1, [Kill(name, entered + more)])
        assert_whole(path)


@pytest.mark.parametrize("name", [RECORDER, ROUTER, "sensors"])
def test_what_is_said_again_goes_to_the_recorder_alone(name: str, tmp_path: Path, story: Simulation) -> None:
    """An old command that is published again might move a robot."""
    path = tmp_path / "run.mcap"
    simulation = recovered(PLAN, path, 2, [Kill(name, happened(story, name) // 2)])
    heard: Counter[tuple[str, str, int]] = Counter()
    for _, process, what in simulation.story:
        if not isinstance(what, Arrived) or process not in NODES or process == name:
            continue
        if what.key.startswith(DATA) and SAID_BY not in what.key:
            heard[process, what.key, decode_envelope(what.attachment).sequence] += 1
    assert set(heard.values()) == {1}
    again = [what for _, _, what in simulation.story if isinstance(what, Put) and what.key.startswith(AGAIN)]
    assert again


@pytest.mark.parametrize("seed", range(8))
def test_two_processes_that_are_killed_one_after_the_other_leave_a_run_that_is_whole_or_says_what_is_lost(
    seed: int, tmp_path: Path, story: Simulation
) -> None:
    path = tmp_path / "run.mcap"
    first, second = EVERYBODY[seed % len(EVERYBODY)], EVERYBODY[(seed * 5 + 1) % len(EVERYBODY)]
    kills = [Kill(first, happened(story, first) // 2), Kill(second, 10 * seed)]
    network = Network(10 ** (5 + seed % 3), 10**5, 10**7)
    recovered(PLAN, path, seed, kills, network=network)
    recording = read_recording(path)
    assert recording.end is not None
    if recording.end.complete:
        assert_whole(path)
    for name in NODES:
        assert replay_node(recording, PLAN, name).mismatch is None


def test_steps_that_are_lost_with_recorder_and_node_are_not_done_otherwise(tmp_path: Path, story: Simulation) -> None:
    """Others have read of them: another step in the place of a lost one would be another truth."""
    path = tmp_path / "run.mcap"
    own = [one for one in story.story if one.process == "estimator"]
    middle = own[len(own) // 2].at_ns

    def without_both(simulation: Simulation, name: str) -> None:
        simulation.kill(name)
        simulation.kill("estimator")
        simulation.later(30_000_000, lambda: again(simulation))

    def again(simulation: Simulation) -> None:
        simulation.restart("estimator", host_of("estimator", PLAN, "estimator-9", patience_ns=PATIENCE_NS))

    recorder = [one for one in story.story if one.process == RECORDER and one.at_ns <= middle]
    simulation = recovered(PLAN, path, 1, [Kill(RECORDER, len(recorder))], act=without_both)
    error = simulation.ended["estimator"]
    recording = read_recording(path)
    assert recording.end is not None
    assert type(error) is RunError
    assert "estimator cannot come back: others have read messages of it on estimator/state" in str(error)
    assert not recording.end.complete
