"""Supervision: who is named and killed, and who only takes long, by the clock of the test."""

from collections.abc import Mapping
from typing import NamedTuple

import pytest
from dynpf_protocol.control import Doing
from dynpf_protocol.errors import BROKEN_OFF
from dynpf_runtime.bus.pulse import Reading
from dynpf_runtime.bus.supervision import (
    STALLED_NS,
    STOPPED_NS,
    Act,
    Asked,
    Finish,
    Kill,
    Restart,
    Say,
    Seen,
    Supervision,
    Terminate,
)
from dynpf_runtime.machines.heartbeats import STEP_NS, WEDGED_NS

NAMES = ("router", "recorder", "simulator", "estimator")
STEP = 20_000_000  # of the test's clock, nanoseconds
SECOND_NS = 10**9


class Acted(NamedTuple):
    at_ns: int
    act: Act


class Watched:
    """A run whose processes do what the test says; all turn, unless it says something else."""

    def __init__(self, restarts: int = 0) -> None:
        self.now_ns = SECOND_NS
        self.acted: list[Acted] = []
        self.asked = Asked()
        self._supervision = Supervision(NAMES, restarts)
        self._others: dict[str, Seen] = {}

    def let(
        self,
        name: str,
        doing: Doing = Doing.TURNING,
        *,
        exit_code: int | None = None,
        stopped: bool = False,
        tick: int = 7,
    ) -> None:
        """Let a process do ``doing`` from now on, or end, or be stopped."""
        self._others[name] = Seen(exit_code, stopped, Reading(doing, self.now_ns, tick, 0))

    def seen(self) -> Mapping[str, Seen]:
        turning = Seen(None, False, Reading(Doing.TURNING, self.now_ns, 3, 0))
        return {name: self._others.get(name, turning) for name in NAMES}

    def run(self, for_ns: int) -> list[Act]:
        """Let time pass, until the supervision finishes; return what it did, killing whom it kills."""
        before, until_ns = len(self.acted), self.now_ns + for_ns
        while self.now_ns < until_ns and not any(isinstance(one.act, Finish) for one in self.acted):
            self.now_ns += STEP
            for act in self._supervision.look(self.seen(), self.asked, self.now_ns):
                self.acted.append(Acted(self.now_ns, act))
                if isinstance(act, Restart):
                    self._others.pop(act.name)
                if isinstance(act, Kill):
                    self.let(act.name, exit_code=-9)
        return [one.act for one in self.acted[before:]]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("doing", Doing)
def test_who_is_stopped_by_a_signal_is_named_and_killed_whatever_it_did(name: str, doing: Doing) -> None:
    run = Watched()
    run.let(name, doing, stopped=True)
    text = f"{name} hangs: a signal has stopped it (SIGSTOP)"
    assert run.run(2 * STOPPED_NS) == [Say(f"{text}; the run cannot go on"), Kill(name)]
    for other in NAMES:
        if other != name:
            run.let(other, exit_code=BROKEN_OFF)
    assert run.run(SECOND_NS) == [Finish(text)]
    assert run.acted[0].at_ns < 3 * SECOND_NS


def test_a_stop_that_is_lifted_at_once_changes_nothing() -> None:
    run = Watched()
    for stopped in (True, False, True, False):
        run.let("estimator", Doing.STEP, stopped=stopped)
        assert run.run(STOPPED_NS // 2) == []


def test_a_main_loop_that_stands_still_is_named_within_three_seconds() -> None:
    run = Watched()
    run.let("estimator")
    said, killed = run.run(2 * WEDGED_NS)
    assert said == Say("estimator hangs: its main loop has stood still for 2.5 s; the run cannot go on")
    assert killed == Kill("estimator")
    assert run.acted[0].at_ns - SECOND_NS < 3 * SECOND_NS


def test_who_is_long_in_starting_is_told_and_not_killed() -> None:
    run = Watched()
    run.let("estimator", Doing.STARTING)
    told = [Say(f"estimator has been starting for {seconds} s") for seconds in (10, 20, 40, 80)]
    assert run.run(100 * SECOND_NS) == told


@pytest.mark.parametrize("doing", [Doing.STEP, Doing.FILE])
def test_who_is_long_in_a_step_or_waits_for_its_disk_is_not_killed(doing: Doing) -> None:
    run = Watched()
    run.let("estimator", doing)
    assert run.run(100 * SECOND_NS) == []


def test_a_step_that_never_ends_has_a_limit() -> None:
    run = Watched()
    run.let("estimator", Doing.STEP)
    assert Kill("estimator") in run.run(STEP_NS + 2 * SECOND_NS)


@pytest.mark.parametrize(("code", "how"), [(-9, "was killed by signal 9"), (1, "ended with exit code 1")])
def test_the_process_that_failed_is_named_whatever_becomes_of_the_others(code: int, how: str) -> None:
    run = Watched()
    run.let("estimator", exit_code=code)
    for other in ("router", "recorder"):
        run.let(other, exit_code=BROKEN_OFF)
    named = [Say(f"estimator {how}; the run cannot go on")] if code < 0 else []  # at once, before the others end
    assert run.run(60 * SECOND_NS) == [*named, Finish(f"estimator {how}; killed what was left: simulator")]
    assert run.now_ns < 4 * SECOND_NS


def test_a_run_that_does_not_go_on_ends_within_three_seconds_of_the_users_wish() -> None:
    run = Watched()
    run.asked = Asked("stopped by the user")
    said, *terminated, finish = run.run(60 * SECOND_NS)
    assert said == Say("stopped by the user: ending the run (again to end it at once)")
    assert terminated == [Terminate(name) for name in NAMES]
    assert isinstance(finish, Finish)
    assert run.now_ns - SECOND_NS < STALLED_NS + 2 * STEP + 1


def test_a_step_may_be_ended_after_the_users_wish_unless_that_is_repeated() -> None:
    run = Watched()
    run.asked = Asked("stopped by the user")
    run.let("estimator", Doing.STEP)
    assert not any(isinstance(act, Finish) for act in run.run(9 * SECOND_NS))
    run.asked = Asked("stopped by the user", at_once=True)
    assert isinstance(run.run(SECOND_NS)[0], Finish)


def test_a_router_that_nobody_can_come_to_any_more_is_ended() -> None:
    run = Watched()
    for name in NAMES[1:]:
        run.let(name, exit_code=2)
    assert Terminate("router") in run.run(SECOND_NS)


def test_a_run_that_ended_well_has_not_failed() -> None:
    run = Watched()
    for name in NAMES:
        run.let(name, exit_code=0)
    assert run.run(SECOND_NS) == [Finish()]


def restarted(run: Watched) -> list[str]:
    return [act.name for act in run.run(SECOND_NS) if isinstance(act, Restart)]


def test_who_is_killed_is_started_again_as_often_as_it_may_and_then_the_run_has_failed() -> None:
    run = Watched(restarts=2)
    for _ in range(2):
        run.let("estimator", exit_code=-9)
        assert restarted(run) == ["estimator"]
    run.let("estimator", exit_code=-9)
    finish = run.run(60 * SECOND_NS)[-1]
    assert isinstance(finish, Finish)
    assert finish.failure.startswith("estimator was killed by signal 9")
    assert finish.died_again is None


def test_each_process_has_restarts_of_its_own() -> None:
    run = Watched(restarts=1)
    run.let("estimator", exit_code=-9)
    run.let("recorder", exit_code=-9)
    assert sorted(restarted(run)) == ["estimator", "recorder"]


@pytest.mark.parametrize("code", [-11, -6, -7])
def test_who_dies_by_itself_twice_in_the_same_step_is_not_started_again(code: int) -> None:
    run = Watched(restarts=3)
    run.let("estimator", Doing.STEP, exit_code=code)
    assert restarted(run) == ["estimator"]
    run.let("estimator", Doing.STEP, exit_code=code)
    finish = run.run(60 * SECOND_NS)[-1]
    assert isinstance(finish, Finish)
    assert finish.failure.startswith(f"estimator has died twice in the step of tick 7 by signal {-code}")
    assert finish.died_again == ("estimator", 7)


@pytest.mark.parametrize(
    ("code", "doing", "tick"),
    [(-9, Doing.STEP, 7), (-11, Doing.TURNING, 7), (-11, Doing.STEP, 8)],
    ids=["killed from outside", "not in a step", "in another step"],
)
def test_who_dies_otherwise_than_before_is_started_again(code: int, doing: Doing, tick: int) -> None:
    run = Watched(restarts=3)
    run.let("estimator", Doing.STEP, exit_code=-11)
    assert restarted(run) == ["estimator"]
    run.let("estimator", doing, exit_code=code, tick=tick)
    assert restarted(run) == ["estimator"]


def test_who_ends_with_an_error_of_its_own_is_not_started_again() -> None:
    run = Watched(restarts=3)
    run.let("estimator", exit_code=1)
    assert restarted(run) == []


def test_who_hangs_is_killed_and_started_again() -> None:
    run = Watched(restarts=1)
    run.let("estimator", stopped=True)
    acts = run.run(STOPPED_NS + SECOND_NS)
    assert [type(act) for act in acts if not isinstance(act, Say)] == [Kill, Restart]


def test_nobody_is_started_again_when_the_run_is_recorded_to_its_end() -> None:
    run = Watched(restarts=3)
    run.let("recorder", exit_code=0)
    run.let("estimator", exit_code=-9)
    assert restarted(run) == []


def test_nobody_is_started_again_when_the_user_has_ended_the_run() -> None:
    run = Watched(restarts=3)
    run.asked = Asked("stopped by the user")
    run.let("estimator", exit_code=-9)
    assert restarted(run) == []
