"""The estimator's judgement of itself in whole runs: on the track, started elsewhere, and without readings."""

from pathlib import Path

import msgspec
import pytest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import Estimate, FilterHealth, Log, LogLevel
from dynpf_runtime.replay import replay_node
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

ELSEWHERE = ("estimator.start.x=5.0", "estimator.start.y=4.0")
RESETTING = "estimator.adaptation=[{kind='sensor_resetting', log_likelihood=-0.2}, {kind='kld', n_max=2000}]"
DEAF = "faults=[{topic='sensors/scan', to='estimator', loss=1.0}]"
KALMAN = "estimator.filter='extended_kalman'"


def run(tmp_path: Path, name: str, *overrides: str) -> Recording:
    scenario = load_scenario(name, overrides=overrides)
    path = tmp_path / "run.mcap"
    record_inline(scenario, path)
    recording = read_recording(path)
    outcome = replay_node(recording, plan_of(scenario), "estimator")
    assert outcome.mismatch is None
    return recording


def healths(recording: Recording) -> list[FilterHealth]:
    found = []
    for one in recording.messages("estimator/state"):
        estimate = decode(one.topic, one.payload)
        assert isinstance(estimate, Estimate)
        assert isinstance(estimate.health, FilterHealth)
        found.append(estimate.health)
    return found


def told(recording: Recording) -> list[tuple[LogLevel, str]]:
    logs = [decode(one.topic, one.payload) for one in recording.messages("log")]
    return [(log.level, log.message) for log in logs if isinstance(log, Log)]


@pytest.mark.parametrize("overrides", [("room-scan",), ("landmark-room",), ("landmark-room", KALMAN)])
def test_a_run_as_it_should_be_is_tracked_throughout(overrides: tuple[str, ...], tmp_path: Path) -> None:
    recording = run(tmp_path, *overrides)
    reports = healths(recording)
    assert {report.status for report in reports} == {"tracking"}
    figures = msgspec.to_builtins(reports[-1].figures)
    assert figures["likelihood_ratio"] > 0.6
    assert figures["n_eff_share"] > 0.01
    assert told(recording) == []


def test_a_robot_that_is_elsewhere_is_lost_until_the_filter_has_found_it(tmp_path: Path) -> None:
    recording = run(tmp_path, "room-scan", *ELSEWHERE, RESETTING, "max_ticks=60")
    statuses = [report.status for report in healths(recording)]
    assert statuses[0] == "tracking"
    assert statuses[20] == "lost"
    assert statuses[-1] == "tracking"
    (lost, found) = told(recording)
    assert lost[0] is LogLevel.WARNING
    assert lost[1].startswith("the estimate is lost: log-likelihood of a reading")
    assert found == (LogLevel.INFO, "the estimate is tracking: all figures are within their limits")


def test_refused_readings_are_a_reason_to_be_lost(tmp_path: Path) -> None:
    refused = run(tmp_path, "landmark-room", "estimator.start.x=1.0", "estimator.start.y=1.0", "max_ticks=200")
    assert any(level is LogLevel.WARNING and "lost: share of refused" in text for level, text in told(refused))


def test_without_readings_the_spread_is_the_reason(tmp_path: Path) -> None:
    silent = run(tmp_path, "room-scan", DEAF, "max_ticks=150")
    ((level, text),) = told(silent)
    assert level is LogLevel.INFO
    assert text.startswith("the estimate is uncertain: position spread")


def test_the_limits_are_the_scenarios(tmp_path: Path) -> None:
    recording = run(tmp_path, "landmark-room", "max_ticks=20", "estimator.health.position_lost=0.001")
    assert healths(recording)[0].status == "lost"
