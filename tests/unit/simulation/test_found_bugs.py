"""Bugs that the simulator has found."""

from types import SimpleNamespace
from typing import cast

import pytest
from dynpf_protocol.control import Doing
from dynpf_protocol.keys import ALIVE, READY, RECORDED, RECORDER
from dynpf_runtime.bus.pulse import Reading
from dynpf_runtime.bus.supervision import Asked, Finish, Seen, Supervision
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.machines.events import RouterGone, Token
from dynpf_runtime.machines.roster import Change, Roster
from dynpf_runtime.simulation import Happened, invariants
from dynpf_runtime.simulation.campaign import Campaign
from dynpf_runtime.simulation.faults import Crash, Cut, Drop, Fault, Freeze, PowerLoss, Tear
from dynpf_runtime.simulation.process import Network
from dynpf_runtime.simulation.schedule import Care, Schedule
from dynpf_runtime.simulation.trial import Trial


def test_a_start_that_took_over_and_was_killed_before_it_was_ready_has_an_heir() -> None:
    roster = Roster([RECORDER])

    def take(prefix: str, start: str, *, present: bool = True) -> Change:
        return roster.take(Token(f"{prefix}{RECORDER}/{start}", present))

    take(ALIVE, "a")
    take(READY, "a")
    assert take(ALIVE, "a", present=False) is Change.GONE
    assert take(ALIVE, "a.1.b") is Change.BACK
    assert take(ALIVE, "a.1.b", present=False) is Change.GONE
    assert roster.starts == {RECORDER: "a.1.b"}, "who comes next would not learn from whom to take over"
    assert take(ALIVE, "a.2.c") is Change.BACK
    assert roster.starts == {RECORDER: "a.2.c"}


def test_a_start_that_learns_later_from_whom_it_takes_over_is_the_same_start() -> None:
    roster = Roster([RECORDER])
    for prefix in (ALIVE, READY):
        roster.take(Token(f"{prefix}{RECORDER}/a", True))
    roster.take(Token(f"{ALIVE}{RECORDER}/a", False))
    assert roster.take(Token(f"{ALIVE}{RECORDER}/a.1.c", True)) is Change.BACK
    assert roster.take(Token(f"{ALIVE}{RECORDER}/a.2.c", True)) is Change.BACK
    assert roster.starts == {RECORDER: "a.2.c"}
    assert roster.take(Token(f"{ALIVE}{RECORDER}/a.3.stranger", True)) is Change.SECOND


def test_who_is_known_by_anothers_word_and_comes_then_is_back_and_may_have_missed_something() -> None:
    roster = Roster([RECORDER])
    roster.know(RECORDER, "a")
    assert roster.take(Token(f"{ALIVE}{RECORDER}/a", True)) is Change.BACK
    assert roster.take(Token(f"{ALIVE}{RECORDER}/a", True)) is Change.NONE


@pytest.mark.parametrize("code", [0, -9, 1])
def test_a_recorder_that_says_that_the_run_is_incomplete_is_heard_though_all_nodes_are_done(code: int) -> None:
    supervision = Supervision(("router", "recorder", "sensors"), restarts=3)
    ended = Reading(Doing.ENDED, 0, 9, 99)
    codes = {"router": 3 if code else 0, "recorder": code, "sensors": 0}
    seen = {name: Seen(code, False, ended) for name, code in codes.items()}
    (finish,) = supervision.look(seen, Asked(), 0)
    assert finish == Finish("recorder ended with exit code 1" if code == 1 else "")


@pytest.mark.parametrize("kept", [0, 200])
def test_a_recorder_that_is_killed_in_any_write_is_taken_over(kept: int, campaign: Campaign) -> None:
    """The last ones follow the end of the run, which says that it is whole."""
    for write in range(campaign.size.writes):
        schedule = Schedule(1, write, (Tear(write, kept),), Network(), Care.KEPT)
        verdict, trial = campaign.judge(schedule, replay=False)
        assert (verdict.whole, verdict.broken) == (True, ())
        assert trial.simulation.processes[RECORDER].exit_code == 0


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(
            Cut("simulator", 0, 5_200_000_000), id="cut off until after the time that the router has to answer"
        ),
        pytest.param(Cut("recorder", 195, 5_000_000_000), id="a recorder that is cut off as it says its last word"),
        pytest.param(Crash("router", 20), id="a router that is killed as the others leave"),
        pytest.param(Crash("simulator", 25), id="a source that spins until its peers know its new start"),
        pytest.param(Drop("recorder", 17), id="the first message of a topic that is not compared is lost"),
        pytest.param(Cut("simulator", 38, 4_800_000_000), id="a source that lacks the end of a tick that is recorded"),
    ],
)
def test_a_single_fault_that_broke_an_invariant(fault: Fault, campaign: Campaign) -> None:
    verdict, _ = campaign.judge(Schedule(1, 44, (fault,), Network(), Care.KEPT), replay=True)
    assert (verdict.whole, verdict.broken) == (True, ())


def test_a_recorder_that_is_started_again_and_cut_off_as_it_listens_takes_over(campaign: Campaign) -> None:
    crash = Crash("recorder", 150)
    for event in range(156, 176, 4):
        schedule = Schedule(1, 44, (crash, Cut("recorder", event, 2_300_000_000)), Network(), Care.KEPT)
        verdict, _ = campaign.judge(schedule, replay=False)
        assert (verdict.whole, verdict.broken) == (True, ())


def test_who_waits_for_a_router_that_never_comes_says_so(campaign: Campaign) -> None:
    verdict, trial = campaign.judge(Schedule(1, 44, (Crash("router", 0),), Network(), Care.ALONE), replay=False)
    assert (verdict.whole, verdict.broken, trial.asked) == (False, (), True)
    assert trial.simulation.notices("sensors") == ["waiting for the router"]


def test_a_source_that_is_dropped_before_it_was_ready_is_told_to_be_waited_for(campaign: Campaign) -> None:
    for event in range(10, 14):
        schedule = Schedule(1, 44, (Freeze("simulator", event, 3_400_000_000),), Network(), Care.ALONE)
        verdict, trial = campaign.judge(schedule, replay=False)
        assert (verdict.whole, verdict.broken, trial.asked) == (False, (), True)
        assert trial.simulation.notices(RECORDER)[:1] == ["waiting for simulator"]


def test_a_last_message_that_is_lost_is_not_in_a_replay_either(campaign: Campaign) -> None:
    last = campaign.size.messages[RECORDER] - 1
    for message in range(last - 20, last):
        schedule = Schedule(1, 44, (Drop(RECORDER, message),), Network(), Care.WATCHED)
        assert campaign.judge(schedule, replay=True)[0].broken == ()


@pytest.mark.parametrize(
    ("began_ns", "said_ns", "knows"), [(4, [5], True), (6, [5], False), (6, [5, 7], True), (6, [], True)]
)
def test_who_is_started_after_the_recorders_last_word_cannot_know_that_the_run_is_over(
    began_ns: int, said_ns: list[int], knows: bool
) -> None:
    """A recorder that never says it is at fault itself."""
    story = [Happened(at_ns, RECORDER, Put(RECORDED, b"")) for at_ns in said_ns]
    simulation = SimpleNamespace(story=story, processes={"sensors": SimpleNamespace(began_ns=began_ns)})
    assert invariants._may_know("sensors", cast(Trial, SimpleNamespace(simulation=simulation))) is knows


def test_a_shorter_cut_does_not_end_a_longer_one(campaign: Campaign) -> None:
    """Who is cut off for longer than the lease finds out."""
    cuts = Cut(RECORDER, 100, 4_000_000_000), Cut(RECORDER, 101, 10_000_000)
    _, trial = campaign.judge(Schedule(1, 44, cuts, Network(), Care.KEPT), replay=False)
    assert any(type(one.what) is RouterGone for one in trial.simulation.story if one.process == RECORDER)


def test_who_learns_from_whom_it_takes_over_while_answers_are_slow_wakes_for_nothing_that_it_cannot_say_yet(
    campaign: Campaign,
) -> None:
    """It does so after a loss of power, when all processes are started again at once."""
    network = Network(delay_ns=47_120, work_ns=343_735, start_ns=85_032_868, answer_ns=165_957_625)
    schedule = Schedule(91, 7931, (PowerLoss(RECORDER, 204, 2),), network, Care.KEPT, 2)
    assert campaign.judge(schedule, replay=False)[0].broken == ()
