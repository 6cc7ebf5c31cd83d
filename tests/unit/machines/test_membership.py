"""Membership by itself: a script tells who appears, who goes, and what comes in between."""

from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from dynpf_protocol.control import Beat, Doing, Recorded, Stop, decode_control, encode_control
from dynpf_protocol.errors import BrokenOffError, DynpfError, UsageError
from dynpf_protocol.keys import ALIVE, BEAT, READY, RECORDED, ROUTER, SCENARIO, STOP
from dynpf_runtime.machines.absence import LAST_WORD_NS, SURE_NS
from dynpf_runtime.machines.effects import Ask, Count, Declare, Effect, Put, Subscribe, Tell
from dynpf_runtime.machines.events import Answered, Arrived, Counted, Event, RouterGone, Started, Token, Woke
from dynpf_runtime.machines.heartbeats import BEAT_NS, WEDGED_NS
from dynpf_runtime.machines.membership import Membership
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import resolved_json

PEERS = ("sensors", "estimator", "controller", "recorder")
SCENARIO_HERE = load_scenario("landmark-room")
TEXT = resolved_json(SCENARIO_HERE)
PREPARED = Subscribe("what it needs")
_OWN = f"{ALIVE}simulator/*"


class Scripted:
    """A membership of the simulator, given one event after the other at a time that the script sets."""

    def __init__(self, boot: str = "mine", *, leads: bool = True, patience_ns: int = 0) -> None:
        plan = plan_of(SCENARIO_HERE)
        self.machine = Membership(
            "simulator", plan, boot, "tcp/here:1", lambda: [PREPARED], leads=leads, patience_ns=patience_ns
        )
        self.now_ns = 0
        self.effects: list[Effect] = []

    def give(self, *events: Event) -> list[Effect]:
        """Return what comes of the events."""
        new = [effect for event in events for effect in self.machine.handle(event, self.now_ns)]
        self.effects += new
        return new

    def joined(self) -> "Scripted":
        self.give(Started(), Answered(TEXT.encode()), Counted(_OWN, ()), Counted(_OWN, (f"{ALIVE}simulator/mine",)))
        return self

    def assembled(self) -> "Scripted":
        self.joined().give(*(token(prefix, node) for prefix in (ALIVE, READY) for node in PEERS))
        assert self.machine.running
        return self

    @property
    def tokens(self) -> list[str]:
        return [effect.key for effect in self.effects if type(effect) is Declare]

    @property
    def told(self) -> list[str]:
        return [effect.text for effect in self.effects if type(effect) is Tell]


def token(prefix: str, node: str, *, present: bool = True, boot: str = "boot") -> Token:
    return Token(f"{prefix}{node}/{boot}", present)


def control(what: str, message: Beat | Recorded | Stop) -> Arrived:
    return Arrived(what, encode_control(message), b"")


def test_it_asks_for_the_scenario_and_its_name_before_it_does_anything_else() -> None:
    one, ask = Scripted(), Ask(SCENARIO, TEXT.encode())
    assert one.give(Started()) == [ask]
    assert one.give(Answered(None)) == []
    one.now_ns = one.machine.wake_ns
    assert one.give(Woke()) == [ask]
    assert one.give(Answered(TEXT.encode())) == [Count(f"{ALIVE}simulator/*")]
    assert one.give(Counted(_OWN, ()))[0] == PREPARED


def test_nobody_who_answers_is_told_after_five_seconds() -> None:
    one = Scripted()
    one.give(Started(), Answered(None))
    one.now_ns = 6 * 10**9
    with pytest.raises(DynpfError, match="the router at tcp/here:1 does not say which scenario it runs"):
        one.give(Woke(), Answered(None))


def test_a_router_that_is_gone_has_its_five_seconds_to_answer_once_it_is_back() -> None:
    one = Scripted(patience_ns=30 * 10**9)
    one.give(Started(), Answered(None))
    one.now_ns = 6 * 10**9
    one.give(RouterGone(), Woke(), Answered(None))
    one.now_ns = 10 * 10**9
    one.give(Woke(), Answered(None))
    one.now_ns = 12 * 10**9
    with pytest.raises(DynpfError, match="does not say which scenario it runs"):
        one.give(Woke(), Answered(None))


def test_it_is_ready_only_when_all_are_alive_and_runs_only_when_all_are_ready() -> None:
    one = Scripted().joined()
    assert one.tokens == [f"{ALIVE}simulator/mine"]
    one.give(*(token(ALIVE, node) for node in PEERS))
    assert one.machine.boots == dict.fromkeys(PEERS, "boot")
    assert one.tokens == [f"{ALIVE}simulator/mine", f"{READY}simulator/mine"]
    one.give(*(token(READY, node) for node in PEERS[1:]), token(READY, "sensors", boot="another"))
    assert not one.machine.running
    one.give(token(READY, "sensors"))
    assert one.machine.running


def test_who_does_not_lead_runs_as_soon_as_it_is_ready() -> None:
    one = Scripted(leads=False).joined()
    one.give(*(token(ALIVE, node) for node in PEERS))
    assert one.machine.running


def test_after_a_second_it_tells_whom_it_waits_for_and_wakes_for_nothing_but_beats() -> None:
    one = Scripted().joined()
    wakes = []
    while one.now_ns < 3 * 10**9:
        one.now_ns = one.machine.wake_ns
        wakes.append(one.now_ns)
        one.give(Woke())
    assert one.told == ["waiting for controller, estimator, recorder, sensors"]
    assert all(later - earlier >= BEAT_NS or later == 10**9 for earlier, later in pairwise(wakes))
    one.give(token(ALIVE, "sensors"))
    assert one.told[1:] == ["waiting for controller, estimator, recorder"]


def test_who_leaves_before_the_run_began_may_be_replaced() -> None:
    script = [token(ALIVE, "sensors"), token(ALIVE, "sensors", present=False), token(ALIVE, "sensors", boot="second")]
    one = Scripted().joined()
    one.give(*script, *(token(ALIVE, node) for node in PEERS[1:]))
    assert one.machine.boots["sensors"] == "second"


def test_of_two_starts_of_a_peer_the_one_that_stays_counts() -> None:
    one = Scripted().joined()
    one.give(token(ALIVE, "sensors"), token(ALIVE, "sensors", boot="second"))
    assert one.machine.boots["sensors"] == "boot"
    one.give(token(ALIVE, "sensors", present=False))
    assert one.machine.boots["sensors"] == "second"
    assert one.told == []


def test_a_second_start_of_a_peer_is_not_believed_once_the_run_has_begun() -> None:
    one = Scripted().assembled()
    one.give(token(ALIVE, "estimator", boot="other"), token(ALIVE, "estimator", boot="other", present=False))
    assert one.machine.boots["estimator"] == "boot"
    assert one.told == ["a second estimator (boot other) is refused; this run's is boot"]


def test_a_name_whose_token_lingers_is_waited_for_for_two_seconds() -> None:
    """The router waits so long for who does not say that it ends; in a run that does not recover nobody does."""
    taken, script = Counted(_OWN, (f"{ALIVE}simulator/other",)), Scripted(patience_ns=30 * 10**9)
    script.give(Started(), Answered(TEXT.encode()), taken)
    for _ in range(19):
        script.now_ns += 10**8
        assert script.give(Woke()) == [Count(_OWN)]
        script.give(taken)
    script.now_ns += 10**8
    script.give(Woke())
    with pytest.raises(UsageError, match="simulator already runs"):
        script.give(taken)
    with pytest.raises(UsageError, match="simulator already runs"):
        Scripted().give(Started(), Answered(TEXT.encode()), taken)


def test_of_two_that_join_at_the_same_moment_the_one_with_the_smaller_boot_stays() -> None:
    for boot, other in (("a", "b"), ("b", "a")):
        one = Scripted(boot)
        one.give(Started(), Answered(TEXT.encode()), Counted(_OWN, ()))
        both = Counted(_OWN, (f"{ALIVE}simulator/a", f"{ALIVE}simulator/b"))
        if boot == "b":
            with pytest.raises(UsageError, match=r"simulator already runs at tcp/here:1 \(boot a\); stop it first"):
                one.give(both)
            continue
        one.give(both, *(token(ALIVE, node) for node in PEERS))
        assert len(one.tokens) == 1, "it is ready although the other is still there"
        one.give(token(ALIVE, "simulator", boot=other, present=False))
        assert len(one.tokens) == 2


def test_who_is_ready_stays_and_the_other_gives_way_whatever_its_boot() -> None:
    ready = Scripted("mine").assembled()
    ready.give(token(ALIVE, "simulator", boot="a"))
    late = Scripted("a")
    late.give(Started(), Answered(TEXT.encode()), Counted(_OWN, ()), Counted(_OWN, (f"{ALIVE}simulator/mine",)))
    with pytest.raises(UsageError, match="simulator already runs"):
        late.give(token(READY, "simulator", boot="mine"))


def test_a_peer_that_goes_breaks_the_run_off_and_is_named_a_moment_later() -> None:
    one = Scripted().assembled()
    one.give(token(ALIVE, "estimator", present=False))
    one.now_ns += SURE_NS
    with pytest.raises(BrokenOffError, match="estimator is gone"):
        one.give(Woke())


def test_when_the_router_goes_it_is_the_router_that_is_named() -> None:
    one = Scripted().assembled()
    one.give(token(ALIVE, "estimator", present=False))
    one.now_ns += SURE_NS
    with pytest.raises(BrokenOffError, match="the router is gone"):
        one.give(RouterGone())


def test_a_peer_that_hangs_by_its_own_beats_ends_the_run_and_a_strangers_beats_do_not() -> None:
    one = Scripted().assembled()
    stuck = Beat("estimator", "boot", 3, Doing.TURNING, WEDGED_NS + 1)
    for boot in ("another", "boot"):
        one.now_ns += BEAT_NS
        beat = control(f"{BEAT}estimator", msgspec.structs.replace(stuck, boot=boot))
        if boot == "another":
            one.give(beat, Woke())
            continue
        with pytest.raises(BrokenOffError, match=r"estimator hangs: its main loop has stood still for 2\.5 s"):
            one.give(beat, Woke())


def test_when_the_run_is_over_everybody_may_go() -> None:
    one = Scripted().assembled()
    one.machine.leaving = True
    one.give(token(ALIVE, "estimator", present=False))
    one.now_ns += SURE_NS
    one.give(Woke(), RouterGone(), control(RECORDED, Recorded("boot", True, "finished", "run.mcap")))
    assert one.machine.recorded is not None
    assert one.machine.recorded.reason == "finished"


def test_a_recording_that_is_closed_too_early_breaks_the_run_off_once_the_recorder_has_gone() -> None:
    one = Scripted().assembled()
    one.give(control(RECORDED, Recorded("boot", False, "no room\x1b left", "run.mcap")))
    one.now_ns += 10 * SURE_NS
    one.give(Woke())  # who says so and stays is a stranger
    one.give(token(ALIVE, "recorder", present=False))
    one.now_ns += LAST_WORD_NS
    with pytest.raises(BrokenOffError, match=r"the recorder has closed the recording: no room\\x1b left"):
        one.give(Woke())


@pytest.mark.parametrize(("node", "boot"), [("sensors", "boot"), ("router", "hub"), ("operator", "hub")])
def test_a_member_the_router_and_the_operator_may_ask_to_stop(node: str, boot: str) -> None:
    one = Scripted().assembled()
    one.give(token(ALIVE, "router", boot="hub"), token(ALIVE, "operator", boot="hub"))
    one.give(control(f"{STOP}{node}", Stop(node, boot, "\x1b[2Jenough")))
    assert (one.machine.stop_reason, one.told) == ("\\x1b[2Jenough", [])


@pytest.mark.parametrize(
    "stranger",
    [
        Arrived(f"{STOP}sensors", b"\xff\xff", b""),
        Arrived(f"{STOP}sensors", bytes(10**6), b""),
        control(f"{STOP}sensors", Stop("sensors", "another", "enough")),
        control(f"{STOP}router", Stop("router", "boot", "enough")),
        control(f"{STOP}router", Stop("sensors", "boot", "enough")),
        control(f"{STOP}nobody", Stop("nobody", "boot", "enough")),
        control(f"{STOP}simulator", Stop("simulator", "mine", "it has not sent this itself")),
        control(RECORDED, Recorded("another", False, "no room left", "run.mcap")),
        control(RECORDED, Recorded("another", True, "finished", "run.mcap")),
        control(RECORDED, Recorded("boot", True, "finished before its end", "run.mcap")),
        control(f"{BEAT}recorder", Beat("recorder", "another", 10**6)),
        control(f"{BEAT}recorder", Beat("sensors", "boot", 10**6)),
    ],
)
def test_a_strangers_word_is_refused_told_and_changes_nothing(stranger: Arrived) -> None:
    one = Scripted().assembled()
    for _ in range(1000):
        one.give(stranger)
    assert (one.machine.stop_reason, one.machine.recorded, one.machine.behind("recorder")) == ("", None, 0)
    assert one.machine.refusals.counts.total() == 1000
    assert len(one.told) == 1
    assert one.told[0].startswith(f"{stranger.key.removeprefix('dynpf/')}: message refused: ")


def test_a_flood_of_second_starts_is_told_of_twice() -> None:
    one = Scripted().assembled()
    for number in range(5000):
        one.give(*(token(ALIVE, "estimator", boot=f"x{number}", present=present) for present in (True, False)))
    assert len(one.told) == 2
    assert one.machine.boots["estimator"] == "boot"


def test_a_beat_counts_only_with_its_peers_boot() -> None:
    one = Scripted().assembled()
    one.give(*(control(f"{BEAT}recorder", Beat("recorder", boot, 7)) for boot in ("boot", "another")))
    one.give(control(f"{BEAT}recorder", Beat("recorder", "another", 10**6)))
    assert one.machine.behind("recorder") == 7


def test_it_beats_twice_a_second() -> None:
    one = Scripted().assembled()
    one.effects.clear()
    while one.now_ns < 10 * BEAT_NS:
        one.now_ns = one.machine.wake_ns
        one.give(Woke())
    assert [type(effect) for effect in one.effects] == [Put] * 10


@pytest.mark.parametrize(
    "answer",
    [
        TEXT.replace('"kind":"arcs"', '"kind":"mark_of_a_stranger:X"').encode(),
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
    one = Scripted()
    one.give(Started(), Answered(answer))
    for _ in range(3):  # it may be a stranger's, who was faster than the router
        one.now_ns = one.machine.wake_ns
        assert one.give(Woke(), Answered(answer)) == [Ask(SCENARIO, TEXT.encode())]
    one.now_ns += 3 * 10**9
    with pytest.raises(DynpfError, match=r"differs from the router's in|sent a scenario that cannot be read"):
        one.give(Answered(answer))
    assert not mark.exists()
    assert not one.machine.joined
    other = Scripted()  # the control: the router's own is taken, also after a stranger's
    other.give(Started(), Answered(answer), Answered(TEXT.encode()), Counted(_OWN, ()))
    assert other.machine.joined


def test_who_is_ready_may_be_heard_of_before_he_is_known_to_be_alive() -> None:
    """By subscriptions of their own the tokens come in any order; those of strangers take no room from others."""
    one = Scripted().joined()
    for number in range(100):
        one.give(token(READY, "recorder", boot=f"stranger{number}"))
    one.give(*(token(READY, node) for node in PEERS if node != "recorder"))
    one.give(*(token(ALIVE, node) for node in PEERS))
    assert not one.machine.running
    one.give(token(READY, "recorder"))
    assert one.machine.running


@pytest.mark.parametrize("ready_first", [True, False])
def test_a_rival_that_is_ready_stays_in_whatever_order_its_tokens_come(ready_first: bool) -> None:
    one = Scripted().joined()
    rival = [token(ALIVE, "simulator", boot="zzz"), token(READY, "simulator", boot="zzz")]
    with pytest.raises(UsageError, match="simulator already runs"):
        one.give(*(reversed(rival) if ready_first else rival))
    alone = Scripted().joined()  # the control: who is ready and never alive is a stranger
    alone.give(token(READY, "simulator", boot="zzz"), *(token(ALIVE, node) for node in PEERS))
    assert f"{READY}simulator/mine" in alone.tokens


def test_who_takes_over_is_no_stranger_by_the_name_that_it_had_before() -> None:
    """Its token may come before, and its beats after, the ones by its new name; another's are told."""
    early = Scripted().joined()
    early.give(token(ALIVE, "sensors", boot="own"), token(READY, "sensors", boot="own"))
    early.give(token(ALIVE, "sensors", boot="boot.1.own"))
    late = Scripted().joined()
    late.give(*(token(prefix, node, boot="boot.1.own") for prefix in (ALIVE, READY) for node in PEERS))
    late.give(control(f"{BEAT}sensors", Beat("sensors", "own", 0)))
    assert [text for one in (early, late) for text in one.told if "refused" in text] == []
    early.give(token(ALIVE, "sensors", boot="boot.1.other"))
    late.give(control(f"{BEAT}sensors", Beat("sensors", "other", 0)))
    assert ["refused" in one.told[-1] for one in (early, late)] == [True, True]


@pytest.mark.parametrize("ready", [False, True])
def test_who_learns_that_it_takes_over_is_the_same_though_its_predecessor_was_not_known_to_be_ready(
    ready: bool,
) -> None:
    """Others have seen the predecessor ready; by then its successor may be ready itself."""
    one = Scripted().joined()
    one.give(token(ALIVE, "sensors", boot="first"), token(ALIVE, "sensors", boot="first", present=False))
    one.give(token(ALIVE, "sensors", boot="own"), *([token(READY, "sensors", boot="own")] if ready else []))
    one.give(token(ALIVE, "sensors", boot="first.1.own"))
    assert one.machine.starts["sensors"] == "first.1.own"
    assert one.machine.boots["sensors"] == "first"
    assert one.told == []


def test_nobody_gets_another_boot_once_the_run_has_begun() -> None:
    """The name may be a stranger's: who is there has no reason to learn from whom it takes over."""
    one = Scripted().assembled()
    one.machine.ticks = 1
    one.give(token(ALIVE, "sensors", boot="stranger.1.boot"))
    assert one.machine.boots["sensors"] == "boot"
    assert one.told == ["a second sensors (boot stranger.1.boot) is refused; this run's is boot"]


def test_who_is_not_ready_yet_tells_from_whom_a_process_has_to_take_over() -> None:
    """If nobody else was ready when it was killed, nobody else says so."""
    one = Scripted(patience_ns=30 * 10**9)
    one.give(Started(), Answered(TEXT.encode()), Counted(_OWN, ()), Counted(f"{READY}**", ()))
    one.give(Counted(_OWN, (f"{ALIVE}simulator/mine",)))
    one.give(token(ALIVE, "recorder"), token(READY, "recorder"), token(ALIVE, "sensors"))
    one.give(token(ALIVE, "recorder", present=False), token(ALIVE, "sensors", present=False))
    one.now_ns = BEAT_NS
    (beat,) = [effect for effect in one.give(Woke()) if type(effect) is Put]
    assert decode_control(beat.payload, Beat).starts == {"recorder": "boot"}


def test_an_answer_about_who_is_ready_that_comes_after_a_heartbeat_names_no_rivals() -> None:
    script = Scripted(patience_ns=30 * 10**9)
    script.give(Started(), Answered(TEXT.encode()), Counted(_OWN, ()))
    script.give(*(token(prefix, node) for prefix in (ALIVE, READY) for node in PEERS))
    script.give(control(f"{BEAT}sensors", Beat("sensors", "boot", 0, starts={"simulator": "first"})))
    assert script.tokens == [f"{ALIVE}simulator/first.1.mine"]
    script.give(Counted(f"{READY}**", tuple(f"{READY}{node}/boot" for node in PEERS)))
    assert not script.machine.alive
    script.give(Counted(_OWN, (f"{ALIVE}simulator/first.1.mine",)))
    assert script.machine.alive


@pytest.mark.parametrize("noticed", [True, False])
def test_who_listens_whether_it_was_there_before_listens_anew_once_the_router_is_back(noticed: bool) -> None:
    """Without the router it hears nobody, and would take itself for the first."""
    script = Scripted(patience_ns=30 * 10**9)
    script.give(Started(), Answered(TEXT.encode()), Counted(_OWN, ()))
    script.give(Counted(f"{READY}**", tuple(f"{READY}{node}/a" for node in PEERS)))
    script.now_ns = 2 * 10**9
    if noticed:
        script.give(RouterGone())
        script.now_ns = 4 * 10**9
        script.give(Woke())
    script.give(Token(f"{ALIVE}{ROUTER}/r", True))
    script.now_ns += 2 * 10**9
    script.give(Woke())
    assert script.tokens == []
    script.now_ns += 10**9
    script.give(Woke())
    assert script.tokens == [f"{ALIVE}simulator/mine"]
