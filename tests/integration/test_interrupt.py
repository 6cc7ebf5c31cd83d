"""Ctrl-C at several moments: a valid recording or none, and no process left."""

import json

import pytest

from tests.integration.processes import processes_of, service_of, until, watch_run


def assert_valid_or_absent(path, here):
    if path.exists():
        info = here("info", path, "--json")
        assert info.code == 0
        assert json.loads(info.out)["truncated"] is False
        assert "byte" not in here("doctor", path).out


def test_ctrl_c_right_after_the_start(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "-o", path)
    until(lambda: service_of(tmp_path, "router"), "the first process")
    run.interrupt()
    assert run.wait() == 1
    assert "stopped by the user before the run had begun" in run.stderr
    assert "Traceback" not in run.stderr
    assert_valid_or_absent(path, here)


def test_ctrl_c_while_the_processes_assemble(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "-o", path)
    until(path.exists, "the recorder's file")
    run.interrupt()
    assert run.wait() in (0, 1)
    assert "Traceback" not in run.stderr
    assert path.exists()
    assert_valid_or_absent(path, here)


@pytest.mark.parametrize("runner", ["bus", "inline"])
def test_ctrl_c_in_mid_run_ends_it_in_good_order(runner, tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--runner", runner, "-o", path)
    if runner == "bus":
        with watch_run(tmp_path, run) as watched:
            watched.await_ticks(30)
    else:
        until(lambda: path.exists() and path.stat().st_size > 50_000, "a growing recording")
    run.interrupt()
    assert run.wait() == 0, run.stderr
    assert "complete: stopped by the user" in run.stdout
    assert here("doctor", path).code == 0
    assert here("replay", path).code == 0


def test_ctrl_c_twice_ends_the_run_at_once(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "-o", path)
    with watch_run(tmp_path, run) as watched:
        watched.await_ticks(30)
    run.interrupt()
    run.says("again to end it at once")
    run.interrupt()
    code = run.wait()
    assert processes_of(tmp_path) == []
    assert "Traceback" not in run.stderr
    if code:
        assert "stopped by the user; killed what was left" in run.stderr
    assert_valid_or_absent(path, here)
