"""What befalls a run, in simulated time: who is named, what is kept, and what changes nothing."""

from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.control import Beat, Outcome, Recorded, Stop, TickDone, decode_control, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import BrokenOffError, UsageError
from dynpf_protocol.journal import decode_entry
from dynpf_protocol.keys import BEAT, DATA, JOURNAL, RECORDED, STOP, TICK
from dynpf_runtime.machines.effects import Effect, Record
from dynpf_runtime.machines.events import Arrived, Event
from dynpf_runtime.machines.heartbeats import BEAT_NS, SILENT_NS
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.simulation import Network, Simulation
from dynpf_services.recorder.host import RecorderFile
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

from tests.unit.machines.conftest import Simulate
from tests.unit.machines.simulated_run import ENDPOINT, host_of

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=40"])
PLAN = plan_of(SCENARIO)
NODES = PLAN.graph.nodes
EVERYBODY = ("router", "recorder", *NODES)


def mid_run(simulation: Simulation, ticks: int = 20) -> None:
    simulation.run(until=lambda: simulation.published[f"{TICK}estimator"] >= ticks)
    assert not simulation.ended


def outcome_of(path: Path) -> str:
    end = read_recording(path).end
    assert end is not None
    return end.outcome


def end_of(path: Path) -> tuple[bool, str]:
    end = read_recording(path).end
    assert end is not None
    return end.complete, end.reason


@pytest.fixture(name="undisturbed", scope="module")
def content_of_an_undisturbed_run(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("undisturbed") / "run.mcap"
    record_inline(SCENARIO, path)
    return content_digest(read_recording(path))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", NODES)
def test_a_killed_node_is_named_by_all_and_what_was_there_is_kept(
    name: str, seed: int, tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, seed)
    mid_run(simulation)
    simulation.kill(name)
    killed_ns = simulation.now_ns
    simulation.run()
    assert simulation.now_ns - killed_ns < BEAT_NS
    assert simulation.ended.keys() == {*EVERYBODY} - {name}
    assert all(type(error) is BrokenOffError for error in simulation.ended.values())
    for other in {"recorder", *NODES} - {name}:
        # Who follows another may be seen to go before the first one is: then that is what happened to it.
        assert "is gone (killed, crashed, stopped or cut off) after tick" in str(simulation.ended[other])
    first = next(iter(simulation.ended.values()))
    assert str(first).startswith(f"{name} is gone")
    assert end_of(path) == (False, str(simulation.ended["recorder"]))
    assert len(list(read_recording(path).journal("estimator", "estimator-1"))) >= 19


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_killed_router_is_named_although_the_peers_tokens_go_first(
    seed: int, tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, seed)
    mid_run(simulation)
    simulation.kill("router")
    simulation.run()
    gone = "the router is gone or hangs; the run cannot go on"
    assert {name: str(error) for name, error in simulation.ended.items()} == dict.fromkeys(("recorder", *NODES), gone)
    assert end_of(path) == (False, gone)


def test_a_killed_recorder_is_named(tmp_path: Path, simulate: Simulate) -> None:
    simulation = simulate(PLAN, tmp_path / "run.mcap")
    mid_run(simulation)
    simulation.kill("recorder")
    simulation.run()
    assert str(simulation.ended["simulator"]).startswith("recorder is gone")
    assert str(simulation.ended["router"]) == "all processes left before the run was recorded"


def test_a_full_disk_ends_the_run(tmp_path: Path, simulate: Simulate) -> None:
    full = RecordingError("run.mcap: no room left to write")
    file = RecorderFile(PLAN, "recorder-1", tmp_path / "run.mcap")

    def perform(effect: Effect) -> Event | None:
        if isinstance(effect, Record) and effect.envelope.tick > 10:
            raise full
        return file.perform(effect)

    simulation = simulate(PLAN, tmp_path / "run.mcap", without=["recorder"])
    simulation.add("recorder", RecorderMachine(PLAN, "recorder-1", ENDPOINT, "run.mcap"), perform)
    with file:
        simulation.run()
    assert simulation.ended["recorder"] is full
    assert all(str(simulation.ended[name]).partition(" (")[0] in GONE for name in NODES)


GONE = {f"{name} is gone" for name in EVERYBODY}


@pytest.mark.parametrize("name", [*NODES, "recorder"])
def test_a_process_that_a_signal_stops_is_named_within_three_seconds(
    name: str, tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    simulation.freeze(name)
    frozen_ns = simulation.now_ns
    simulation.run(until=lambda: bool(simulation.ended))
    assert simulation.now_ns - frozen_ns < 3 * 10**9
    assert str(next(iter(simulation.ended.values()))).startswith(
        f"{name} is gone (killed, crashed, stopped or cut off)"
    )
    simulation.run()
    if name != "recorder":
        assert end_of(path) == (False, str(simulation.ended["recorder"]))


def test_a_router_that_a_signal_stops_is_named_within_three_seconds(tmp_path: Path, simulate: Simulate) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    simulation.freeze("router")
    frozen_ns = simulation.now_ns
    simulation.run(until=lambda: simulation.ended.keys() == {"recorder", *NODES})
    assert simulation.now_ns - frozen_ns < 3 * 10**9
    gone = "the router is gone or hangs; the run cannot go on"
    assert {str(error) for error in simulation.ended.values()} == {gone}
    assert end_of(path) == (False, gone)


def test_a_node_that_says_nothing_while_it_is_connected_is_named_after_fifteen_seconds(
    tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    simulation.hang("estimator")
    hung_ns = simulation.now_ns
    simulation.run(until=lambda: bool(simulation.ended))
    assert SILENT_NS - BEAT_NS < simulation.now_ns - hung_ns < SILENT_NS + 2 * BEAT_NS
    assert str(next(iter(simulation.ended.values()))) == (
        "estimator hangs: it has said nothing for 15 s; the run cannot go on"
    )
    others = {*EVERYBODY} - {"estimator", "router"}  # the router is there while somebody is
    simulation.run(until=lambda: simulation.ended.keys() == others)
    assert end_of(path)[0] is False


def test_who_has_another_scenario_is_refused_with_the_first_key_that_differs(
    tmp_path: Path, simulate: Simulate, undisturbed: str
) -> None:
    other = plan_of(load_scenario("landmark-room", overrides=["max_ticks=40", "estimator.n=7"]))
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, without=["estimator"])
    simulation.add("another", host_of("estimator", other, "estimator-0"))
    simulation.run(until=lambda: "another" in simulation.ended)
    refused = simulation.ended["another"]
    assert type(refused) is UsageError
    n = SCENARIO.estimator.n
    assert str(refused) == (f"refused: this scenario differs from the router's in estimator.n: here 7, there {n}")
    simulation.add("estimator", host_of("estimator", PLAN, "estimator-1"))
    simulation.run()
    assert content_digest(read_recording(path)) == undisturbed


@pytest.mark.parametrize(("max_ticks", "outcome"), [(40, Outcome.BUDGET), (2000, Outcome.DONE)])
def test_the_end_of_a_run_tells_whether_its_task_was_done_or_its_budget_spent(
    max_ticks: int, outcome: Outcome, tmp_path: Path, simulate: Simulate
) -> None:
    scenario = load_scenario("landmark-room", overrides=[f"max_ticks={max_ticks}", "estimator.n=10"])
    on_the_bus, inline = tmp_path / "bus.mcap", tmp_path / "inline.mcap"
    simulate(plan_of(scenario), on_the_bus).run()
    record_inline(scenario, inline)
    assert outcome_of(on_the_bus) == outcome_of(inline) == outcome


@pytest.mark.parametrize("name", EVERYBODY)
def test_asked_to_stop_once_the_run_ends_complete(name: str, tmp_path: Path, simulate: Simulate) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    simulation.ask_to_stop(name, "stopped by the user")
    simulation.run()
    assert set(simulation.ended.values()) == {None}
    assert end_of(path) == (True, "stopped by the user")
    assert outcome_of(path) == Outcome.STOPPED
    assert 20 <= simulation.published[f"{TICK}estimator"] < 30


@pytest.mark.parametrize("name", EVERYBODY)
def test_asked_to_stop_twice_a_process_ends_at_once_and_the_recording_is_closed(
    name: str, tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    for at_once in (False, True):
        simulation.ask_to_stop(name, "stopped by the user", at_once=at_once)
    simulation.run()
    assert type(simulation.ended[name]) is KeyboardInterrupt
    others = {simulation.ended[other] for other in {*EVERYBODY} - {name}}
    assert all(error is None or isinstance(error, BrokenOffError) for error in others)  # None: its last step was made
    assert others != {None}
    assert end_of(path)[0] is False
    if name == "recorder":
        assert end_of(tmp_path / "run.mcap") == (False, "stopped by the user")


@pytest.mark.parametrize("name", EVERYBODY)
def test_asked_to_stop_before_the_run_has_begun_a_process_ends_at_once(
    name: str, tmp_path: Path, simulate: Simulate
) -> None:
    lacks = "sensors" if name != "sensors" else "estimator"
    simulation = simulate(PLAN, tmp_path / "run.mcap", without=[lacks])
    simulation.run(until=lambda: simulation.now_ns > 2 * 10**9)
    assert simulation.notices(name) == ([] if name == "router" else [f"waiting for {lacks}"])
    simulation.ask_to_stop(name, "stopped by the user")
    simulation.run(until=lambda: name in simulation.ended)
    assert type(simulation.ended[name]) is KeyboardInterrupt
    if name == "recorder":
        assert end_of(tmp_path / "run.mcap") == (False, "stopped before the run began")


@pytest.mark.parametrize(
    ("key", "topic"),
    [
        (f"{DATA}estimator/state", "estimator/state"),
        (f"{DATA}diagnostics/-/sensors", None),
        (f"{JOURNAL}sensors", "journal/sensors"),
    ],
)
def test_a_message_that_the_recorder_never_gets_makes_the_recording_incomplete(
    key: str, topic: str | None, tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    losses: list[Arrived] = []

    def lost(process: str, arrived: Arrived) -> bool:
        if process == "recorder" and arrived.key == key and not losses:
            losses.append(arrived)
            return True
        return False

    simulation.lost = lost
    simulation.run()
    assert losses
    if topic is None:  # the control: nobody has promised what only looks at the process
        assert end_of(path) == (True, "finished")
        return
    assert end_of(path) == (False, f"never arrived: 1 on {topic}")
    assert str(simulation.ended["recorder"]) == f"{path} is incomplete: never arrived: 1 on {topic}"
    assert str(simulation.ended["router"]) == f"the run ended incomplete: never arrived: 1 on {topic}"
    assert {simulation.ended[name] for name in NODES} == {None}


def test_the_recorder_waits_for_the_last_entry_of_a_node_that_is_held_up(tmp_path: Path, simulate: Simulate) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    held: list[tuple[int, Arrived]] = []

    def late(process: str, arrived: Arrived) -> bool:
        if process == "recorder" and arrived.key == f"{JOURNAL}sensors" and decode_entry(arrived.payload).last:
            held.append((simulation.now_ns, arrived))
            return True
        return process == "recorder" and arrived.key == f"{BEAT}sensors" and bool(held)

    simulation.lost = late
    simulation.run(until=lambda: bool(held) and simulation.now_ns > held[0][0] + 10 * 10**9)
    simulation.lost = lambda _process, _arrived: False
    simulation.publish(*held[0][1])
    simulation.run()
    assert end_of(path) == (True, "finished")


def test_a_recorder_that_leaves_without_a_last_word_is_named(tmp_path: Path, simulate: Simulate) -> None:
    simulation = simulate(PLAN, tmp_path / "run.mcap")
    simulation.lost = lambda process, arrived: arrived.key == RECORDED and process != "router"
    simulation.run()
    assert all(str(simulation.ended[name]).startswith("recorder is gone") for name in NODES)
    assert all(type(simulation.ended[name]) is BrokenOffError for name in NODES)
    assert simulation.now_ns < 4 * 10**9


def test_what_a_stranger_says_changes_nothing(tmp_path: Path, simulate: Simulate, undisturbed: str) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    state = Envelope("estimator", "another", 10**6, 1, 0, 0)
    for key, message in (
        (f"{BEAT}estimator", Beat("estimator", "another", 10**6)),
        (f"{TICK}estimator", TickDone("estimator", "another", 10**6, 10**6, 0, {}, True)),
        (f"{STOP}sensors", Stop("sensors", "another", "enough")),
        (f"{STOP}router", Stop("router", "another", "enough")),
        (RECORDED, Recorded("another", True, "finished", "other.mcap")),
        (RECORDED, Recorded("another", False, "no room left", "other.mcap")),
    ):
        simulation.publish(key, encode_control(message))
        simulation.publish(key, b"\xff")
    simulation.publish(f"{DATA}estimator/state", b"{}", encode_envelope(state))
    simulation.publish(f"{JOURNAL}estimator", b"{}", encode_envelope(state))
    simulation.run()
    assert set(simulation.ended.values()) == {None}
    assert content_digest(read_recording(path)) == undisturbed
    notices = simulation.notices("simulator")
    refused = [text for text in notices if "message refused" in text]
    assert len([text for text in refused if "unknown sender" in text]) == 1, "of which key it tells is chance"
    assert len(refused) <= 3  # a line for each kind
    assert len(simulation.notices("router")) == 2  # of control/recorded alone, one of each kind
    refusals = [text for text in simulation.notices("recorder") if "journal/estimator: message refused" in text]
    assert refusals == [
        "journal/estimator: message refused: unknown sender 'estimator' with boot 'another'; "
        "this run's is 'estimator-1'"
    ]


def test_the_same_words_of_a_member_do_change_the_run(tmp_path: Path, simulate: Simulate, undisturbed: str) -> None:
    """The control of the test before this one."""
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path)
    mid_run(simulation)
    simulation.publish(f"{STOP}sensors", encode_control(Stop("sensors", "sensors-1", "enough")))
    simulation.run()
    assert end_of(path) == (True, "enough")
    assert content_digest(read_recording(path)) != undisturbed


def test_a_process_that_starts_again_before_the_run_began_takes_part_by_its_new_boot(
    tmp_path: Path, simulate: Simulate, undisturbed: str
) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, without=["sensors"])
    simulation.run(until=lambda: simulation.now_ns > 10**9)
    simulation.kill("estimator")
    simulation.add("estimator again", host_of("estimator", PLAN, "estimator-2"))
    simulation.run(until=lambda: simulation.now_ns > 2 * 10**9)
    simulation.add("sensors", host_of("sensors", PLAN, "sensors-1"))
    simulation.run()
    assert set(simulation.ended.values()) == {None}
    recording = read_recording(path)
    assert list(recording.boots("estimator")) == ["estimator-2"]
    assert content_digest(recording) == undisturbed


def test_a_process_that_starts_again_in_mid_run_is_too_late(tmp_path: Path, simulate: Simulate) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, network=Network(start_ns=0))
    mid_run(simulation)
    simulation.kill("estimator")
    simulation.add("estimator again", host_of("estimator", PLAN, "estimator-2"))
    simulation.run(until=lambda: {"simulator", "recorder"} <= simulation.ended.keys())
    assert "is gone" in str(simulation.ended["simulator"])
    assert end_of(path)[0] is False


def test_a_second_process_of_a_name_is_refused_in_mid_run(tmp_path: Path, simulate: Simulate, undisturbed: str) -> None:
    path = tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, network=Network(start_ns=0))
    mid_run(simulation)
    simulation.add("second", host_of("estimator", PLAN, "another"))
    simulation.run()
    assert str(simulation.ended.pop("second")) == (
        f"estimator already runs at {ENDPOINT} (boot estimator-1); stop it first"
    )
    assert set(simulation.ended.values()) == {None}
    assert content_digest(read_recording(path)) == undisturbed


@pytest.mark.parametrize("role", ["estimator", "simulator"])
def test_of_two_that_start_under_one_name_at_the_same_moment_one_is_refused_and_the_run_is_whole(
    role: str, tmp_path: Path, simulate: Simulate, undisturbed: str
) -> None:
    refused = []
    for seed in range(12):
        path = tmp_path / f"{seed}.mcap"
        simulation = simulate(PLAN, path, seed, network=Network(start_ns=2_000_000))
        simulation.add("twin", host_of(role, PLAN, "a-twin" if seed % 2 else "z-twin"))
        simulation.run()
        (loser,) = (name for name, error in simulation.ended.items() if error is not None)
        assert type(simulation.ended[loser]) is UsageError
        assert content_digest(read_recording(path)) == undisturbed
        refused.append(loser)
    assert {*refused} == {role, "twin"}


def test_what_the_control_messages_carry_is_read_back() -> None:
    for message in (Stop("sensors", "b", "enough"), Recorded("b", True, "finished", "run.mcap")):
        assert decode_control(encode_control(message), type(message)) == message


@pytest.mark.parametrize(
    ("name", "topic", "tick", "sender"),
    [("estimator", "sensors/odometry", 0, "sensors"), ("simulator", "controller/command", 1, "controller")],
)
def test_a_node_that_does_not_hear_what_was_sent_to_it_says_so(
    name: str, topic: str, tick: int, sender: str, *, tmp_path: Path, simulate: Simulate
) -> None:
    simulation = simulate(PLAN, tmp_path / "run.mcap")
    simulation.lost = lambda process, arrived: process == name and arrived.key == DATA + topic
    simulation.run(until=lambda: simulation.now_ns > 10 * 10**9)
    assert simulation.notices(name) == [
        f"tick {tick} does not begin, though {sender} sent all that it waits for: it was lost, or {name}'s key may not "
        "hear it"
    ]
    assert [simulation.notices(other) for other in {*NODES} - {name}] == [[], [], []]


def test_a_node_that_waits_for_another_that_hangs_does_not_blame_its_key(tmp_path: Path, simulate: Simulate) -> None:
    """The control of the test before this one."""
    simulation = simulate(PLAN, tmp_path / "run.mcap")
    mid_run(simulation)
    simulation.hang("sensors")
    simulation.run(until=lambda: simulation.now_ns > 10 * 10**9)
    assert [simulation.notices(name) for name in ("simulator", "estimator", "controller")] == [[], [], []]
