"""Processes that are killed or hang in mid-run: the run goes on, or ends, says who it was, and keeps what it had."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

from tests.integration.processes import processes_of, service_of, until, watch_run


def kill(folder, name, number=signal.SIGKILL):
    process = service_of(folder, name)
    assert process is not None
    os.kill(process.pid, number)


def await_mid_run(folder, run, ticks=30):
    with watch_run(folder, run) as watched:
        watched.await_ticks(ticks)


def assert_valid_and_incomplete(path, here):
    doctor = here("doctor", path, "--json")
    assert doctor.code == 1
    findings = json.loads(doctor.out)["findings"]
    assert any(finding["what"].startswith("the run is not complete") for finding in findings)
    assert {finding["where"] for finding in findings if "byte" in finding["where"]} == set(), "the file is damaged"
    info = json.loads(here("info", path, "--json").out)
    assert info["complete"] is False
    assert info["truncated"] is False
    assert info["ticks"] >= 30


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("estimator", signal.SIGKILL),
        ("simulator", signal.SIGSTOP),
        ("router", signal.SIGKILL),
        ("recorder", signal.SIGKILL),
    ],
)  # anywhere in a run, and several: tests/unit/machines/test_recovery.py
def test_a_process_that_is_killed_or_hangs_is_started_again_and_the_run_has_the_same_bytes(
    name, number, tmp_path, dynpf, here
):
    path, undisturbed = tmp_path / "run.mcap", tmp_path / "inline.mcap"
    settings = "landmark-room", "--set", "max_ticks=200"
    assert here("run", *settings, "--runner", "inline", "-o", undisturbed).code == 0
    run = dynpf("run", *settings, "-o", path)
    await_mid_run(tmp_path, run)
    kill(tmp_path, name, number)
    assert run.wait() == 0, run.stderr
    assert f"dynpf run: {name} was killed by signal 9; starting it again (1 of at most 3)" in run.stderr
    assert "Traceback" not in run.stderr
    assert content_digest(read_recording(path)) == content_digest(read_recording(undisturbed))
    told = json.loads(here("info", path, "--json").out)["restarts"]
    assert [one["node"] for one in told] == [name]
    assert here("doctor", path).code == 0
    assert here("replay", path).code == 0


def test_a_realtime_run_goes_on_while_one_process_after_the_other_is_killed(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--clock", "realtime", "--set", "rate=2.0", "-o", path)
    await_mid_run(tmp_path, run, 12)
    killed = ["estimator", "recorder", "router"]
    for name in killed:  # anywhere: tests/unit/machines/test_realtime_recovery.py
        kill(tmp_path, name)
        run.says(f"dynpf recorder: {name} is back: started again after tick")
    await_mid_run(tmp_path, run, 12)
    run.interrupt()
    assert run.wait() == 0, run.stderr
    assert "refused" not in run.stderr
    assert "Traceback" not in run.stderr
    told = json.loads(here("info", path, "--json").out)["restarts"]
    assert sorted(one["node"] for one in told) == sorted(killed)  # the killed recorder may not have written of it
    assert here("doctor", path).code == 0
    recording = read_recording(path)
    assert any(True for _ in recording.messages("event/estimator")), "the estimator has missed nothing"
    replayed = here("replay", path, "--json")
    assert replayed.code == 0, replayed.out
    assert json.loads(replayed.out)["counts"]["estimator"]["steps"] > 30


@pytest.mark.parametrize("name", ["estimator", "router"])  # all others: tests/unit/machines/test_breaking_off.py
def test_a_killed_process_ends_the_run_and_is_named_if_it_is_not_started_again(name, tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "parts-3-tracked", "--restarts", "0", "-o", path)
    await_mid_run(tmp_path, run)
    kill(tmp_path, name)
    assert run.wait() == 1
    assert processes_of(tmp_path) == []
    assert f"dynpf run: {name} was killed by signal 9" in run.stderr
    assert "Traceback" not in run.stderr
    assert str(path) in run.stderr
    assert_valid_and_incomplete(path, here)


def test_what_a_killed_recorder_had_is_recovered_up_to_half_a_second_before(tmp_path, dynpf, here):
    path, mended = tmp_path / "run.mcap", tmp_path / "mended.mcap"
    run = dynpf("run", "parts-3-tracked", "--restarts", "0", "-o", path)
    await_mid_run(tmp_path, run, 150)
    killed_ns = time.time_ns()
    kill(tmp_path, "recorder")
    assert run.wait() == 1
    assert "dynpf run: recorder was killed by signal 9" in run.stderr

    doctor = here("doctor", path)
    assert doctor.code == 1
    assert "the end of the run was never written" in doctor.out
    recovered = here("recover", path, "-o", mended)
    assert recovered.code == 0, recovered.err
    assert "incomplete" in recovered.out
    recording = read_recording(mended)
    last_ns = max(record.publish_ns for record in recording.records if record.topic != "recorder/gap")
    assert killed_ns - last_ns < 500_000_000
    assert here("doctor", mended).code == 1
    assert len({node for node, _ in recording.journals()}) == 4
    print(f"recorder killed: lost {(killed_ns - last_ns) / 1e9:.3f} s")


@pytest.mark.parametrize("name", ["estimator", "router"])  # all others: tests/unit/bus/test_supervision.py
def test_a_process_that_a_signal_stops_ends_the_run_and_is_named(name, tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "parts-3-tracked", "--restarts", "0", "-o", path)
    await_mid_run(tmp_path, run)
    kill(tmp_path, name, signal.SIGSTOP)
    assert run.wait() == 1
    assert f"\ndynpf run: {name} hangs: a signal has stopped it (SIGSTOP); the run cannot go on\n" in run.stderr
    assert run.stderr.endswith(f"dynpf run: {name} hangs: a signal has stopped it (SIGSTOP)\n")
    assert "Traceback" not in run.stderr
    assert_valid_and_incomplete(path, here)


def test_a_stopped_subscriber_of_a_stranger_changes_nothing(tmp_path, dynpf, here):
    run = dynpf("run", "landmark-room", "--insecure", "-o", tmp_path / "run.mcap")
    node = until(lambda: service_of(tmp_path, "estimator"), "the estimator's process")
    assert node is not None
    with stranger(node.endpoint) as other:
        await_mid_run(tmp_path, run)
        other.send_signal(signal.SIGSTOP)
        assert run.wait() == 0, run.stderr
    assert "Traceback" not in run.stderr
    assert "complete: finished" in run.stdout
    assert here("doctor", tmp_path / "run.mcap").code == 0


@contextmanager
def stranger(endpoint):
    """A process of somebody else's that subscribes to everything."""
    source = """
import json, sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
while True:  # the router may be starting
    try:
        session = zenoh.open(config)
        break
    except zenoh.ZError:
        pass
subscriber = session.declare_subscriber("dynpf/**", lambda _: None)
print(flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", source, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline()
            yield process
        finally:
            process.kill()


def test_processes_end_by_themselves_when_the_run_command_is_killed(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "-o", path)
    await_mid_run(tmp_path, run)
    run.popen.kill()
    run.wait()
    assert processes_of(tmp_path), "the run had already ended"
    until(lambda: not processes_of(tmp_path), "the end of the processes", 20.0)
    assert here("doctor", path).code == 0
    assert "dynpf run, which had started it, was killed" in here("metrics", path).out


def test_no_process_waits_for_ever_when_the_run_command_is_killed_at_the_start(tmp_path, dynpf):
    run = dynpf("run", "landmark-room", "-o", tmp_path / "run.mcap")
    until(lambda: service_of(tmp_path, "router"), "the first process")
    run.popen.kill()
    run.wait()
    until(lambda: not processes_of(tmp_path), "the end of the processes", 20.0)


def test_a_stopped_process_and_the_runs_folder_do_not_outlive_the_run_command(tmp_path, dynpf):
    run = dynpf("run", "landmark-room", "-o", tmp_path / "run.mcap")
    await_mid_run(tmp_path, run)
    assert list(tmp_path.glob("dynpf-*")), "the run has no folder"
    kill(tmp_path, "estimator", signal.SIGSTOP)
    run.popen.kill()
    run.wait()
    until(lambda: not processes_of(tmp_path), "the end of the processes", 20.0)
    assert not list(tmp_path.glob("dynpf-*"))
