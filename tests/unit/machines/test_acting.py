"""What a person does to a simulated world, in whole runs on a simulated network: it enters once, and is the run's."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple, Protocol

import pytest
from dynpf_formats.recording.doctor import altered
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.codec import decode
from dynpf_protocol.control import Act, Pace, TickDone, decode_control, encode_control
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.keys import ACT, ALIVE, OPERATOR, TICK
from dynpf_protocol.messages import Log, RobotState
from dynpf_runtime.machines.effects import NEVER_NS, Declare, Effect, Put, Subscribe
from dynpf_runtime.machines.events import Arrived, Event, Now, Started
from dynpf_runtime.plan import Plan
from dynpf_runtime.simulation import Simulation
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import acts_of
from dynpf_systems.rooms.world import RoomSimulator

from tests.unit.machines.recovering import Kill, recovered
from tests.unit.machines.simulated_run import simulated

BOOT = "a-person"


class Wish(NamedTuple):
    """What an operator asks for, once the simulator has ended a tick."""

    tick: int
    topic: str = ""
    payload: bytes = b""
    pace: Pace | None = None
    times: int = 1  # it is said


def place(tick: int, x: float, y: float) -> Wish:
    return Wish(tick, "operator/place", b'{"x":%g,"y":%g,"theta":0.5}' % (x, y))


class Operator:
    """The machine of an operator, whose token is there if it ``declares`` itself."""

    def __init__(self, wishes: Sequence[Wish], *, declares: bool = True, boot: str = BOOT) -> None:
        self.wake_ns = NEVER_NS
        self.said = 0
        self.ticks = 0
        self._wishes, self._declares, self._boot = list(wishes), declares, boot

    def handle(self, event: Event, _now: Now) -> Iterator[Effect]:
        match event:
            case Started():
                yield Subscribe(f"{TICK}**")
                if self._declares:
                    yield Declare(f"{ALIVE}{OPERATOR}/{self._boot}")
            case Arrived(key, payload) if key == f"{TICK}simulator":
                self.ticks = decode_control(payload, TickDone).tick
                while self._wishes and self.ticks >= self._wishes[0].tick:
                    wish = self._wishes.pop(0)
                    said = Act(OPERATOR, self._boot, self.said, wish.topic, wish.payload, wish.pace)
                    self.said += 1
                    yield from [Put(ACT + OPERATOR, encode_control(said))] * wish.times


def plan(clock: str = "lockstep", ticks: int = 60) -> Plan:
    overrides = [f"max_ticks={ticks}", "state_digest_ticks=5"]
    return plan_of(load_scenario("landmark-room", overrides=overrides, clock=clock))


def at_tick(recording: Recording, tick: int) -> RobotState:
    """Return the true state of a tick."""
    (record,) = [each for each in recording.messages("truth/robot") if recording.tick_of(each) == tick]
    message = decode("truth/robot", record.payload)
    assert isinstance(message, RobotState)
    return message


def same(path: Path) -> bool:
    return main(["replay", str(path), "--json"]) == 0


class Run(Protocol):
    """Runs a plan with a person who wishes for something, and returns the recording."""

    def __call__(self, of: Plan, wishes: Sequence[Wish], *, declares: bool = True) -> Recording: ...


@pytest.fixture(name="run")
def recorded(tmp_path: Path) -> Run:
    def run(of: Plan, wishes: Sequence[Wish], *, declares: bool = True) -> Recording:
        path = tmp_path / "run.mcap"
        with ExitStack() as files:
            simulation = simulated(files, of, path)
            simulation.add("person", Operator(wishes, declares=declares))
            simulation.run(until=lambda: simulation.ended.get("recorder", "runs") is None)
        return read_recording(path)

    return run


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_robot_that_is_carried_is_there_at_the_next_tick_and_the_replay_is_the_same(run: Run, clock: str) -> None:
    recording = run(plan(clock), [place(20, 1.0, -0.5)])
    assert recording.end is not None
    assert recording.end.complete
    ((tick, acts),) = acts_of(recording).items()
    assert [act.topic for act in acts] == ["operator/place"]
    assert 21 <= tick <= 24
    there = at_tick(recording, tick)
    assert (there.x, there.y, there.theta) == (1.0, -0.5, 0.5)
    assert abs(at_tick(recording, tick - 1).x - 1.0) > 0.2
    assert same(recording.path)
    assert altered(recording) == []


def test_a_request_that_comes_twice_counts_once(run: Run) -> None:
    recording = run(plan(), [place(20, 1.0, -0.5)._replace(times=2)])
    assert [len(acts) for acts in acts_of(recording).values()] == [1]
    assert any("request 0 of the operator again" in message.message for message in logs(recording))


def test_a_run_without_an_operator_has_nothing_of_it(run: Run) -> None:
    assert "operator/place" not in run(plan(), []).schemas


def test_what_cannot_be_is_refused_and_told(run: Run) -> None:
    wishes = [
        place(5, 100.0, 0.0),  # outside the room
        Wish(6, "operator/place", b'{"x":1e999,"y":0,"theta":0}'),
        Wish(7, "operator/place", b'{"x":null,"y":0,"theta":0}'),
        Wish(8, "operator/door", b'{"door":0,"to":"open"}'),  # this room has none
        Wish(9, "truth/robot", b'{"x":0,"y":0,"theta":0}'),
        Wish(10, "controller/command", b"{}"),
    ]
    recording = run(plan(), wishes)
    assert acts_of(recording) == {}
    assert recording.end is not None
    assert recording.end.complete
    texts = [message.message for message in logs(recording)]
    assert any("does not fit into the room at (100.000, 0.000)" in text for text in texts)
    assert any("takes such acts" in text for text in texts)


def wait(simulation: Simulation, seconds: float) -> None:
    """Simulate so many seconds."""
    until_ns = simulation.now_ns + round(seconds * 1e9)
    simulation.run(until=lambda: simulation.now_ns >= until_ns)


def logs(recording: Recording) -> list[Log]:
    found = [decode("notice", record.payload) for record in recording.messages("notice")]
    return [message for message in found if isinstance(message, Log)]


def test_who_has_no_token_acts_on_nothing(run: Run) -> None:
    recording = run(plan(), [place(20, 1.0, -0.5)], declares=False)
    assert acts_of(recording) == {}
    assert any("no operator who is there" in message.message for message in logs(recording))


def test_a_paused_run_stands_still_steps_and_goes_on(tmp_path: Path) -> None:
    with ExitStack() as files:
        simulation = simulated(files, plan(), tmp_path / "run.mcap")
        operator = Operator([Wish(20, pace=Pace(paused=True, rate=0.0))])
        simulation.add("person", operator)
        wait(simulation, 20)
        stood = operator.ticks
        assert 20 <= stood < 30
        assert "recorder" not in simulation.ended
        assert not {"simulator", "estimator", "controller"} & simulation.ended.keys()
        simulation.publish(ACT + OPERATOR, encode_control(Act(OPERATOR, BOOT, 1, pace=Pace(True, 3, 0.0))))
        wait(simulation, 5)
        assert operator.ticks == stood + 3
        simulation.publish(ACT + OPERATOR, encode_control(Act(OPERATOR, BOOT, 2, pace=Pace(rate=0.0))))
        simulation.run(until=lambda: simulation.ended.get("recorder", "runs") is None)
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.end is not None
    assert recording.end.complete
    assert any("has paused the run" in message.message for message in logs(recording))
    assert same(recording.path)


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
@pytest.mark.parametrize("after", [40, 97, 131, 180, 233, 301])
def test_a_killed_simulator_does_again_what_a_person_did(tmp_path: Path, clock: str, after: int) -> None:
    path = tmp_path / "run.mcap"
    wishes = [place(tick, 0.1 * (tick % 7), -0.1 * (tick % 5)) for tick in range(4, 56, 2)]

    def begin(simulation: Simulation) -> None:
        simulation.add("person", Operator(wishes))

    recovered(plan(clock), path, after, [Kill("simulator", after)], begin=begin)
    recording = read_recording(path)
    assert recording.end is not None
    assert recording.end.complete
    assert len(acts_of(recording)) > 5
    assert [*recording.messages("recorder/restart")]
    assert same(path)
    assert altered(recording) == []


def test_a_world_that_fails_to_judge_an_act_goes_on_without_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RoomSimulator, "refuses", lambda *_: 1 / 0)
    recording = run(plan(), [place(20, 1.0, -0.5)])
    assert recording.end is not None
    assert recording.end.complete
    assert acts_of(recording) == {}
    assert any("ZeroDivisionError" in message.message for message in logs(recording))


def test_no_fault_of_the_network_befalls_an_act() -> None:
    fault = 'faults=[{topic="operator/place", to="simulator", loss=1.0}]'
    with pytest.raises(ScenarioError, match=r"simulator does not read operator/place; it reads controller/command$"):
        plan_of(load_scenario("landmark-room", overrides=[fault]))
