"""Processes that are killed or hang in mid-run and are started again: the run has the bytes of an undisturbed one."""

import json
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.info import restarts
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import BrokenOffError, RunError
from dynpf_protocol.keys import RECALLED, RECORDER, ROUTER, data_key
from dynpf_protocol.messages import Command
from dynpf_protocol.recall import decode_recalled
from dynpf_runtime import snapshot
from dynpf_runtime.machines import unconfirmed, window
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.machines.heartbeats import BEAT_NS
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.node import Result
from dynpf_runtime.simulation import Network, Simulation
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

from tests.unit.machines.recovering import NETWORK, PATIENCE_NS, Kill, recovered
from tests.unit.services.toy_nodes import ToyNode, graph_of, says

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=8", "estimator.n=10"])
PLAN = plan_of(SCENARIO)
EVERYBODY = (ROUTER, RECORDER, *PLAN.graph.nodes)


@pytest.fixture(name="undisturbed", scope="module")
def content_of_an_undisturbed_run(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("undisturbed") / "run.mcap"
    record_inline(SCENARIO, path)
    return content_digest(read_recording(path))


@pytest.fixture(name="lengths", scope="module")
def events_and_effects_of_each_process(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    simulation = recovered(PLAN, tmp_path_factory.mktemp("lengths") / "run.mcap", 1, [])
    return {name: sum(one.process == name for one in simulation.story) for name in EVERYBODY}


def assert_whole(path: Path, digest: str) -> None:
    recording = read_recording(path)
    assert recording.end is not None
    assert (recording.end.complete, recording.end.reason) == (True, "finished")
    assert content_digest(recording) == digest


@pytest.mark.parametrize("name", EVERYBODY)
def test_a_process_that_is_killed_anywhere_does_not_change_the_run(
    name: str, tmp_path: Path, undisturbed: str, lengths: dict[str, int]
) -> None:
    moments = 8
    for part in range(moments + 1):
        path = tmp_path / f"{part}.mcap"
        network = NETWORK._replace(delay_ns=10 ** (5 + part % 3))
        recovered(PLAN, path, part, [Kill(name, part * (lengths[name] - 1) // moments)], network=network)
        assert_whole(path, undisturbed)


@pytest.mark.parametrize("name", EVERYBODY)
def test_a_process_that_hangs_and_is_started_again_does_not_change_the_run(
    name: str, tmp_path: Path, undisturbed: str, lengths: dict[str, int]
) -> None:
    recovered(PLAN, tmp_path / "run.mcap", 3, [Kill(name, lengths[name] * 3 // 4)], act=Simulation.freeze)
    assert_whole(tmp_path / "run.mcap", undisturbed)


@pytest.mark.parametrize("seed", range(12))
def test_two_that_are_killed_one_in_the_others_recovery_do_not_change_the_run(
    seed: int, tmp_path: Path, undisturbed: str, lengths: dict[str, int]
) -> None:
    random = Random(seed)
    first, second = random.choice(EVERYBODY), random.choice(EVERYBODY)
    kills = [Kill(first, random.randrange(lengths[first])), Kill(second, random.randrange(40))]
    network = Network(10 ** random.randint(5, 7), 10 ** random.randint(4, 5), 10 ** random.randint(7, 8))
    recovered(PLAN, tmp_path / "run.mcap", seed, kills, network=network)
    assert_whole(tmp_path / "run.mcap", undisturbed)


@pytest.mark.parametrize("seed", range(16))
def test_two_that_are_killed_while_all_join_do_not_change_the_run(seed: int, tmp_path: Path, undisturbed: str) -> None:
    """Answers are slow: some take themselves for ready long before others do."""
    random = Random(seed)
    kills = [
        Kill(random.choice(EVERYBODY), random.randrange(10, 40)),
        Kill(random.choice(EVERYBODY), random.randrange(60)),
    ]
    recovered(PLAN, tmp_path / "run.mcap", seed, kills, network=NETWORK._replace(answer_ns=2 * 10**8))
    assert_whole(tmp_path / "run.mcap", undisturbed)


@pytest.mark.parametrize(("name", "after"), [("estimator", 80), (RECORDER, 200), (ROUTER, 15)])
def test_the_recording_tells_who_was_started_again_and_what_it_has_cost(name: str, after: int, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recovered(PLAN, path, 2, [Kill(name, after)])
    (told,) = restarts(read_recording(path))
    assert told.node == name
    assert 0 < told.absent_s < 2
    assert main(["doctor", str(path)]) == 0
    assert main(["replay", str(path)]) == 0


def test_the_recording_tells_of_a_node_that_came_back_while_the_recorder_was_away(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recovered(PLAN, path, 2, [Kill("estimator", 80), Kill(RECORDER, 0)])
    told = {one.node: one for one in restarts(read_recording(path))}
    assert told.keys() == {"estimator", RECORDER}
    assert told["estimator"].before == "estimator-1"
    assert told["estimator"].start.startswith("estimator-1.1.")


def test_a_node_that_says_something_comes_back_though_its_process_has_refused_something(tmp_path: Path) -> None:
    """What is refused, and when, follows from nothing that its next start does again."""
    lossy = "faults=[{topic='sensors/odometry', to='estimator', loss=0.3}]"  # of which the estimator warns
    scenario = load_scenario("landmark-room", overrides=["max_ticks=30", "estimator.n=10", lossy])
    stranger = encode_envelope(Envelope("sensors", "sensors-1", 10**6, 3, 3, 0))

    def refuse_and_kill(simulation: Simulation, name: str) -> None:
        simulation.publish(data_key("sensors/odometry", "sensors"), b"{nonsense", stranger)
        simulation.later(10**7, lambda: simulation.kill(name))

    path = tmp_path / "run.mcap"
    recovered(plan_of(scenario), path, 1, [Kill("estimator", 40)], act=refuse_and_kill)
    recording = read_recording(path)
    assert recording.end is not None
    assert recording.end.complete
    texts = {
        topic: [json.loads(one.payload)["message"] for one in recording.messages(topic) if one.node == "estimator"]
        for topic in ("log", "notice")
    }
    assert texts["log"]
    assert "message refused" in texts["notice"][0]


def test_a_run_whose_process_does_not_come_back_breaks_off_when_patience_has_ended(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    simulation = recovered(PLAN, path, 1, [Kill("estimator", 80)], act=_for_good)
    assert PATIENCE_NS < simulation.now_ns < PATIENCE_NS + 2 * 10**9
    assert type(simulation.ended[RECORDER]) is BrokenOffError
    assert str(simulation.ended[RECORDER]).startswith("estimator is gone (killed, crashed, stopped or cut off)")
    end = read_recording(path).end
    assert end is not None
    assert not end.complete


def _for_good(simulation: Simulation, name: str) -> None:
    simulation.kill(name)
    simulation.restart = lambda *_: None  # type: ignore[method-assign]


def test_a_node_that_does_not_do_the_same_again_is_not_believed(tmp_path: Path) -> None:
    """A step that follows from something else than parameters and inputs cannot be taken over."""
    calls: Iterator[int] = iter(range(10**6))
    source = ToyNode(
        "simulator", writes=["controller/command"], act=lambda _: says("controller/command", Command(vx=next(calls)))
    )
    follower = ToyNode("estimator", reads=["controller/command"], act=lambda _: Result())
    plan = PLAN._replace(graph=graph_of([source, follower]), max_ticks=30, state_digest_ticks=1)
    simulation = recovered(plan, tmp_path / "run.mcap", 1, [Kill("simulator", 60)])
    error = simulation.ended["simulator"]
    assert type(error) is RunError
    assert "its step" in str(error)


def test_a_run_of_which_too_much_is_recorded_ends_with_a_node_that_is_lost(
    tmp_path: Path, lengths: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(window, "MOST_BYTES", 1000)
    path = tmp_path / "run.mcap"
    simulation = recovered(PLAN, path, 1, [Kill("estimator", lengths["estimator"] * 3 // 4)])
    assert "estimator cannot come back: too much has been recorded" in str(simulation.ended["estimator"])
    recording = read_recording(path)
    assert recording.end is not None
    assert not recording.end.complete


@pytest.fixture(name="snapshots_at_every_step")
def snapshots_at_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshot, "_OFTEN", 1)
    monkeypatch.setattr(snapshot, "_SENT_PER_BYTE", 0)
    monkeypatch.setattr(snapshot, "_FIRST_SENT_PER_BYTE", 0)


LONG = load_scenario("landmark-room", overrides=["max_ticks=30", "estimator.n=10", "state_digest_ticks=2"])


@pytest.mark.usefixtures("snapshots_at_every_step")
@pytest.mark.parametrize("name", EVERYBODY)
def test_a_node_goes_on_from_its_last_snapshot_and_the_run_has_the_same_bytes(name: str, tmp_path: Path) -> None:
    """What is done again is only what came after."""
    record_inline(LONG, tmp_path / "undisturbed.mcap")
    undisturbed = content_digest(read_recording(tmp_path / "undisturbed.mcap"))
    simulation = recovered(plan_of(LONG), tmp_path / "run.mcap", 1, [Kill(name, 60 if name == ROUTER else 160)])
    assert_whole(tmp_path / "run.mcap", undisturbed)
    answers = [
        decode_recalled(what.payload)
        for _, _, what in simulation.story
        if isinstance(what, Put) and what.key.startswith(RECALLED)
    ]
    if name in PLAN.graph.nodes:
        (snapshot_step,) = [answer.next_tick for answer in answers if answer.snapshot]
        again = sum(len(answer.entries) for answer in answers)
        assert snapshot_step > 8
        assert again <= 12


def kept(tmp_path: Path) -> float:
    """Return the share of what was recorded that the recorder still has in its memory at the end of a run."""
    path = tmp_path / "run.mcap"
    simulation = recovered(plan_of(LONG), path, 1, [], network=Network(delay_ns=20_000_000))
    recorder = simulation.processes[RECORDER].machine
    assert isinstance(recorder, RecorderMachine)
    recorded = sum(len(one.payload) for one in read_recording(path).messages())
    return recorder._ledger.window.size / recorded


def test_after_the_first_snapshot_the_recorder_keeps_all_that_follows(tmp_path: Path) -> None:
    assert kept(tmp_path) > 0.9


@pytest.mark.usefixtures("snapshots_at_every_step")
def test_with_snapshots_the_recorder_keeps_what_came_after_them_alone(tmp_path: Path) -> None:
    assert kept(tmp_path) < 0.4


@pytest.mark.usefixtures("snapshots_at_every_step")
@pytest.mark.parametrize("seed", range(6))
def test_two_that_are_killed_in_a_run_with_snapshots_do_not_change_it(seed: int, tmp_path: Path) -> None:
    record_inline(LONG, tmp_path / "undisturbed.mcap")
    undisturbed = content_digest(read_recording(tmp_path / "undisturbed.mcap"))
    random = Random(seed)
    kills = [Kill(random.choice(PLAN.graph.nodes), random.randrange(100, 300)), Kill(RECORDER, random.randrange(90))]
    recovered(plan_of(LONG), tmp_path / "run.mcap", seed, kills)
    assert_whole(tmp_path / "run.mcap", undisturbed)


def test_who_may_keep_no_message_waits_for_the_recorder_and_for_nothing_else(
    tmp_path: Path, undisturbed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unconfirmed, "MOST_UNCONFIRMED", 0)
    simulation = recovered(PLAN, tmp_path / "run.mcap", 1, [])
    assert_whole(tmp_path / "run.mcap", undisturbed)
    assert simulation.now_ns > 2 * BEAT_NS, "nobody has waited for a heartbeat of the recorder"
