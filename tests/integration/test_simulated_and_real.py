"""The simulated protocol is the real one: a schedule of crashes has the same end in both."""

import os
import signal

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_runtime.simulation.faults import Crash
from dynpf_runtime.simulation.process import Network
from dynpf_runtime.simulation.schedule import Care, Schedule
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.simulate import campaign_of

from tests.integration.processes import service_of, watch_run

TICKS = 300
CRASHES = (Crash("sensors", 150), Crash("recorder", 1500))


def end_of(path):
    """Whether a recording is whole, what its end says but for the tick, and its digest if it is whole."""
    recording = read_recording(path)
    end = recording.end
    assert end is not None
    return end.complete, end.reason.partition(" after tick")[0], content_digest(recording) if end.complete else ""


@pytest.mark.parametrize("care", [Care.WATCHED, Care.KEPT])
def test_a_schedule_of_crashes_ends_alike_simulated_and_real(care, tmp_path, dynpf):
    with campaign_of(load_scenario("landmark-room", overrides=[f"max_ticks={TICKS}"]), 1) as campaign:
        verdict, trial = campaign.judge(Schedule(1, 0, CRASHES, Network(), care), replay=True)
        assert verdict.broken == ()
        simulated = end_of(trial.path)

    path = tmp_path / "run.mcap"
    restarts = 3 if care is Care.KEPT else 0
    run = dynpf("run", "landmark-room", "--set", f"max_ticks={TICKS}", "--restarts", restarts, "-o", path)
    with watch_run(tmp_path, run) as watched:
        for number, crash in enumerate(CRASHES[: 1 + (restarts > 0)], start=1):
            watched.await_ticks(20 * number)
            service = service_of(tmp_path, crash.process)
            assert service is not None
            os.kill(service.pid, signal.SIGKILL)
            if restarts:
                run.says(f"{crash.process} was killed by signal 9; starting it again")
    assert run.wait() == int(not verdict.whole)
    assert end_of(path) == simulated
    assert simulated[0] is (care is Care.KEPT)
