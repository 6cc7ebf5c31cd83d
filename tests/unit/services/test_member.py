"""Membership without a network: a scripted bus tells who appears, who goes, and what comes in between."""

from collections import deque
from contextlib import nullcontext
from pathlib import Path

import pytest
from dynpf_protocol.control import Beat, Recorded, Stop, encode_control
from dynpf_protocol.errors import BrokenOffError, DynpfError
from dynpf_runtime.bus.member import Member, StopSignal, join
from dynpf_runtime.bus.session import ALIVE, BEAT, CONTROL, DATA, READY, Arrival
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import resolved_json

PEERS = ("sensors", "estimator", "controller", "recorder")


class ScriptedBus:
    """Gives the arrivals of a script one by one; remembers what was said."""

    def __init__(self, *script: Arrival) -> None:
        self.script = deque(script)
        self.connected = True
        self.said: list[str] = []

    def receive(self, _timeout_s: float) -> Arrival | None:
        return self.script.popleft() if self.script else None

    def put(self, key: str, _payload: bytes) -> None:
        self.said.append(key)

    def declare(self, key: str) -> None:
        self.said.append(key)


def token(prefix: str, node: str, *, present: bool = True, boot: str = "boot") -> Arrival:
    return Arrival(f"{prefix}{node}/{boot}", b"", b"", present)


def data(topic: str = "truth/robot") -> Arrival:
    return Arrival(DATA + topic, b"{}", b"", True)


def member(*script: Arrival) -> Member:
    bus = ScriptedBus(*script)
    return Member("simulator", bus, plan_of(load_scenario("landmark-room")), "mine", StopSignal())  # type: ignore[arg-type]


def assembled(*script: Arrival) -> Member:
    everybody = [token(prefix, node) for prefix in (ALIVE, READY) for node in PEERS]
    one = member(*everybody, *script)
    one.assemble(leads=True)
    return one


def take_all(one: Member) -> list[Arrival]:
    polled = [one.poll(0.0) for _ in range(20)]  # more than any script here is long
    return [arrival for arrival in polled if arrival is not None]


def test_it_is_ready_only_when_all_are_alive() -> None:
    one = assembled()
    assert one.boots == dict.fromkeys(PEERS, "boot")
    tokens = [key for key in one.bus.said if key.startswith((ALIVE, READY))]  # type: ignore[attr-defined]
    assert tokens == [f"{ALIVE}simulator/mine", f"{READY}simulator/mine"]


def test_what_comes_while_it_waits_is_given_later_in_order() -> None:
    first, second = data("truth/robot"), data("truth/parts")
    everybody = [token(ALIVE, node) for node in PEERS]
    one = member(first, *everybody[:2], second, *everybody[2:], data("truth/scene"))
    one.assemble(leads=False)
    assert [arrival.key for arrival in take_all(one)] == [
        f"{DATA}truth/robot",
        f"{DATA}truth/parts",
        f"{DATA}truth/scene",
    ]


def test_who_leaves_before_the_run_began_may_be_replaced() -> None:
    script = [token(ALIVE, "sensors"), token(ALIVE, "sensors", present=False), token(ALIVE, "sensors", boot="second")]
    one = member(*script, *(token(ALIVE, node) for node in PEERS[1:]))
    one.assemble(leads=False)
    assert one.boots["sensors"] == "second"


def test_a_second_start_of_a_peer_is_not_believed(capsys: pytest.CaptureFixture[str]) -> None:
    one = assembled(token(ALIVE, "estimator", boot="other"), token(ALIVE, "estimator", boot="other", present=False))
    take_all(one)
    assert one.boots["estimator"] == "boot"
    assert "second estimator" in capsys.readouterr().err


def test_a_peer_that_goes_breaks_the_run_off_and_is_named() -> None:
    one = assembled(token(ALIVE, "estimator", present=False))
    with pytest.raises(BrokenOffError, match="estimator is gone"):
        take_all(one)


def test_when_the_router_goes_it_is_the_router_that_is_named() -> None:
    one = assembled(token(ALIVE, "estimator", present=False))
    one.bus.connected = False  # type: ignore[misc]
    with pytest.raises(BrokenOffError, match="the router is gone"):
        take_all(one)


def test_when_the_run_is_over_everybody_may_go() -> None:
    over = Arrival(f"{CONTROL}recorded", encode_control(Recorded(True, "finished", "run.mcap")), b"", True)
    one = assembled(token(ALIVE, "estimator", present=False), over)
    assert one.await_recorded().reason == "finished"


def test_a_recording_that_is_closed_too_early_breaks_the_run_off() -> None:
    closed = Arrival(f"{CONTROL}recorded", encode_control(Recorded(False, "no room left", "run.mcap")), b"", True)
    with pytest.raises(BrokenOffError, match="no room left"):
        take_all(assembled(closed))


def test_somebody_may_ask_to_stop_and_garbage_is_not_heard(capsys: pytest.CaptureFixture[str]) -> None:
    garbage = Arrival(f"{CONTROL}stop", b"\xff\xff", b"", True)
    one = assembled(garbage, Arrival(f"{CONTROL}stop", encode_control(Stop("sensors", "enough")), b"", True))
    take_all(one)
    assert one.stop_reason == "enough"
    assert "message refused" in capsys.readouterr().err


def test_a_beat_counts_only_with_its_peers_boot() -> None:
    beats = [Beat("recorder", "boot", 7), Beat("recorder", "another", 10**6)]
    one = assembled(*(Arrival(f"{BEAT}recorder", encode_control(beat), b"", True) for beat in beats))
    take_all(one)
    assert one.behind("recorder") == 7


class AnsweringBus(ScriptedBus):
    """Gives one answer to whoever asks for the scenario."""

    def __init__(self, answer: bytes) -> None:
        super().__init__()
        self.answer = answer

    def ask(self, *_: object, **__: object) -> bytes:
        return self.answer

    def tokens(self, _key: str) -> list[str]:
        return []

    def wake(self) -> None: ...

    subscribe = watch = ScriptedBus.declare


@pytest.mark.parametrize(
    "answer",
    [
        resolved_json(load_scenario("landmark-room"))
        .replace('"kind":"arcs"', '"kind":"mark_of_a_stranger:X"')
        .encode(),
        b'{"map":{"kind":"bitmap","file":"/dev/zero"},"maps":["/etc/passwd"]}',
        b"\xff\xfe",
        b"no JSON",
        b"[" * 100_000,
        b'{"a":' * 900 + b"1" + b"}" * 900,
    ],
)
def test_a_strangers_scenario_is_refused_and_nothing_that_it_names_is_touched(
    answer: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mark = tmp_path / "mark"
    (tmp_path / "mark_of_a_stranger.py").write_text(f"open({str(mark)!r}, 'x').close()")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("dynpf_runtime.bus.member.Bus.connect", lambda *_: nullcontext(AnsweringBus(answer)))
    ours = load_scenario("landmark-room")
    with pytest.raises(DynpfError, match=r"differs from the router's in|tells a scenario that cannot be read"):
        join("estimator", plan_of(ours), "tcp/127.0.0.1:1", StopSignal()).__enter__()
    assert not mark.exists()
    monkeypatch.setattr(AnsweringBus, "ask", lambda *_, **__: resolved_json(ours).encode())
    join("estimator", plan_of(ours), "tcp/127.0.0.1:1", StopSignal()).__enter__()  # the control: the same one is taken
