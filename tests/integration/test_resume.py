"""Everything is killed, and the run goes on; a node that dies again in the same step is told with what it was given."""

import os
import re
import signal

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

from tests.integration.processes import processes_of, service_of, watch_run

DEADLY = """
import os, signal
import numpy as np

class Walk:
    def __init__(self, at):
        self.at = at

    def particles(self, poses, stream):
        return poses

    def propagate(self, particles, control, stream):
        self.at -= 1
        if self.at == 0:
            os.kill(os.getpid(), signal.SIGSEGV)
        return particles
"""


def test_everything_is_killed_and_the_run_is_resumed_with_the_same_bytes(tmp_path, dynpf, here):
    path, undisturbed = tmp_path / "run.mcap", tmp_path / "inline.mcap"
    settings = "landmark-room", "--set", "max_ticks=600"
    assert here("run", *settings, "--runner", "inline", "-o", undisturbed).code == 0
    run = dynpf("run", *settings, "--durable", "-o", path)
    with watch_run(tmp_path, run) as watched:
        watched.await_ticks(30)
    assert service_of(tmp_path, "recorder") is not None
    os.kill(run.popen.pid, signal.SIGSTOP)  # else it starts the first ones again before the last are killed
    for process in processes_of(tmp_path):
        os.kill(process.pid, signal.SIGKILL)
    run.popen.kill()
    assert run.wait() == -signal.SIGKILL
    doctor = here("doctor", path)
    assert doctor.code == 1
    assert f"dynpf resume {path} goes on with the run" in doctor.out
    resumed = dynpf("resume", path)
    assert resumed.wait() == 0, resumed.stderr
    assert "Traceback" not in resumed.stderr
    assert "refused" not in resumed.stderr, "nobody is a stranger"
    assert content_digest(read_recording(path)) == content_digest(read_recording(undisturbed))
    assert "recorder was gone after tick" in resumed.stdout
    again = here("resume", path)
    assert again.code == 2
    assert "the run is whole" in again.err


def test_a_node_that_dies_again_in_the_same_step_is_told_with_the_messages_of_that_step(tmp_path, dynpf):
    (tmp_path / "deadly.py").write_text(DEADLY)
    motion = "estimator.motion={kind='deadly:Walk', at=20}"
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--set", motion, "--code", tmp_path, "-o", path)
    assert run.wait() == 1
    assert "estimator was killed by signal 11; starting it again (1 of at most 3)" in run.stderr
    found = re.search(r"the step of tick (\d+) of estimator ends so whenever it is made; it is given (.*)", run.stderr)
    assert found is not None, run.stderr
    assert f"estimator has died twice in the step of tick {found[1]} by signal 11" in run.stderr
    assert f"sensors/odometry {found[1]}" in found[2]
