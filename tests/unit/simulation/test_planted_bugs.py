"""The simulator is not blind: bugs that are put into the machines on purpose are found, and shrunk to few faults."""

from collections.abc import Sequence

import pytest
from dynpf_runtime.simulation.campaign import Campaign
from dynpf_runtime.simulation.faults import Clock, Crash, Delay, Duplicate, Fault, Reorder, Slow, Tear
from dynpf_runtime.simulation.process import Network
from dynpf_runtime.simulation.schedule import Care, Schedule
from dynpf_runtime.simulation.shrink import shrunk
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.simulate import campaign_of

from tests.unit.simulation.planted_bugs import BUGS, wrong_bound

HARMLESS: tuple[Fault, ...] = (
    Clock("router", 5, -(10**9)),
    Slow("controller", 10, 5, 10**6),
    Delay("simulator", 9, 10**6),
    Reorder("estimator", 7, 10**6),
)

BRINGS_IT_ABOUT: dict[str, Fault] = {
    "a lost confirmation": Crash("recorder", 100),
    "an off-by-one in the successor's sequence": Crash("sensors", 28),
    "a recorder that appends twice": Crash("estimator", 30),
    "a swallowed duplicate": Duplicate("controller", 10, 50_000),
    "a forgotten timer": Tear(14, 7),
}


@pytest.mark.parametrize("name", BUGS)
def test_a_planted_bug_is_found_and_shrunk_to_few_faults(
    name: str, campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = (*HARMLESS[:2], BRINGS_IT_ABOUT[name], *HARMLESS[2:])

    def breaks(chosen: Sequence[Fault]) -> bool:
        schedule = Schedule(1, 44, tuple(chosen), Network(), Care.KEPT)
        return bool(campaign.judge(schedule, replay=False)[0].broken)

    assert not breaks(faults), "the control: without the bug nothing is wrong"
    BUGS[name](monkeypatch)
    assert breaks(faults)
    few = shrunk(faults, breaks)
    assert 0 < len(few) <= 3
    assert BRINGS_IT_ABOUT[name] in few


def test_a_planted_bug_of_those_who_go_on_from_snapshots_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    with campaign_of(load_scenario("landmark-room", overrides=["max_ticks=40"]), 81) as campaign:
        whole, enough = campaign.schedule(396), campaign.schedule(396, [3])
        assert whole.snapshot_digests
        assert not campaign.judge(whole, replay=False)[0].broken, "the control: without the bug nothing is wrong"
        wrong_bound(monkeypatch)
        assert campaign.judge(whole, replay=False)[0].broken
        assert campaign.judge(enough, replay=False)[0].broken
