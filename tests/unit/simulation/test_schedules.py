"""Schedules of faults: none breaks an invariant, and each is the same whenever it is played."""

from collections import Counter
from collections.abc import Sequence

from dynpf_runtime.machines.effects import Record
from dynpf_runtime.simulation.campaign import Campaign
from dynpf_runtime.simulation.faults import Clock, Crash, Cut, Delay, Drop, Fault, FullDisk, Hang, PowerLoss, Reorder
from dynpf_runtime.simulation.process import Network
from dynpf_runtime.simulation.schedule import KINDS, Care, Schedule
from dynpf_runtime.simulation.timeline import timeline
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.simulate import campaign_of

from tests.unit.simulation.conftest import SCENARIO

SCHEDULES = range(200)
SECOND = 10**9


def of(care: Care, *faults: Fault) -> Schedule:
    return Schedule(1, 0, faults, Network(), care)


def test_no_schedule_breaks_an_invariant(campaign: Campaign) -> None:
    verdicts = list(campaign.verdicts(SCHEDULES, 2))
    assert sorted(verdict.number for verdict in verdicts) == [*SCHEDULES]
    assert [verdict for verdict in verdicts if verdict.broken] == []
    whole = sum(verdict.whole for verdict in verdicts)
    assert 50 < whole < 180, "the faults are too harmless, or too harsh"


def test_no_schedule_breaks_an_invariant_of_a_realtime_run() -> None:
    scenario = load_scenario("landmark-room", overrides=["max_ticks=25"], clock="realtime")
    with campaign_of(scenario, 1) as campaign:
        verdicts = list(campaign.verdicts(range(30), 2))
    assert [verdict for verdict in verdicts if verdict.broken] == []
    whole = sum(verdict.whole for verdict in verdicts)
    assert 8 < whole < 26, "the faults are too harmless, or too harsh"


def test_the_schedules_have_every_kind_of_fault_together_and_alone(campaign: Campaign) -> None:
    schedules = [campaign.schedule(number) for number in SCHEDULES]
    kinds = Counter(kind for schedule in schedules for kind in {type(fault) for fault in schedule.faults})
    assert len(kinds) == len(KINDS)
    assert min(kinds.values()) > 10
    assert {len({type(fault) for fault in schedule.faults}) for schedule in schedules} >= {0, 1, 2, 3, 4, 5}
    assert {schedule.care for schedule in schedules} == {*Care}


def test_a_schedule_is_the_same_story_to_the_last_byte(campaign: Campaign) -> None:
    schedule = campaign.schedule(5)
    first, again = (_told(campaign, schedule) for _ in range(2))
    assert first == again
    assert first != _told(campaign, schedule._replace(faults=()))


def _told(campaign: Campaign, schedule: Schedule) -> tuple[list[str], bytes]:
    _, trial = campaign.judge(schedule, replay=False)
    return [repr(happened) for happened in trial.simulation.story], trial.path.read_bytes()


def test_a_memory_of_the_nodes_changes_nothing(campaign: Campaign) -> None:
    with campaign_of(SCENARIO, 1, memory=False) as executed:
        for number in range(20, 26):
            schedule = campaign.schedule(number)
            assert executed.schedule(number) == schedule
            assert _told(campaign, schedule) == _told(executed, schedule)


def test_who_is_killed_is_started_again_and_the_run_is_whole(campaign: Campaign) -> None:
    crashes: list[Fault] = [
        Crash("estimator", 30, 2, 1),
        Crash("recorder", 100),
        Crash("router", 9),
        Hang("sensors", 25, 0),
    ]
    for fault in crashes:
        verdict, trial = campaign.judge(of(Care.KEPT, fault), replay=True)
        assert (verdict.whole, verdict.broken) == (True, ())
        assert any("is started again" in line for line in timeline(trial, campaign.source))
        without, _ = campaign.judge(of(Care.WATCHED, fault), replay=False)
        assert (without.whole, without.broken) == (False, ())


def test_faults_that_harm_nothing_leave_a_whole_run(campaign: Campaign) -> None:
    faults = (
        Cut("sensors", 20, SECOND),
        Delay("estimator", 5, SECOND // 2),
        Reorder("controller", 8, SECOND // 4),
        Clock("recorder", 50, -3600 * SECOND),
    )
    verdict, trial = campaign.judge(of(Care.ALONE, *faults), replay=True)
    assert (verdict.whole, verdict.broken) == (True, ())
    assert trial.simulation.now_ns > SECOND, "they have struck nothing"


def test_what_is_lost_is_told(campaign: Campaign) -> None:
    for fault in (Drop("recorder", 60), FullDisk(20_000), PowerLoss("recorder", 120, 7)):
        verdict, trial = campaign.judge(of(Care.WATCHED, fault), replay=True)
        assert (verdict.whole, verdict.broken) == (False, ())
        recorded = sum(type(happened.what) is Record for happened in trial.simulation.story)
        assert recorded > 20, "the fault has struck before anything was recorded"


def test_a_schedule_is_told_by_its_faults(campaign: Campaign) -> None:
    numbers: Sequence[int] = [1, 0]
    schedule = campaign.schedule(5)
    assert campaign.schedule(5, numbers).faults == (schedule.faults[1], schedule.faults[0])
    assert str(of(Care.KEPT, Crash("estimator", 30, 2, 1))).splitlines() == [
        "schedule 0 of seed 1: who is killed or hangs is started again; at most delay 2 ms, work 0.2 ms, start 100 ms, "
        "answer 0 ms",
        "  0  Crash(process=estimator, event=30, effects=2, unsent=1)",
    ]
