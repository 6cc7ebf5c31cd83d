"""A user's own models, in a folder on PYTHONPATH, take part in runs and replays as the library's do."""

import json
import subprocess
import sys
from textwrap import dedent

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

LAB = """
    import numpy as np
    from dynpf.measurement.range_bearing import RangeBearingReadings

    class Walk:
        def __init__(self, step):
            self.step = step

        def particles(self, poses, stream):
            return poses

        def propagate(self, particles, control, stream):
            moved = particles + np.float32(self.step) * stream.normals(*particles.shape)
            moved[0] += np.float32(control.v * control.duration) * np.cos(moved[2])
            moved[1] += np.float32(control.v * control.duration) * np.sin(moved[2])
            moved[2] += np.float32(control.w * control.duration)
            return moved

    class Ranges:
        reading = RangeBearingReadings
        uses = ("landmarks",)

        def __init__(self, sigma, landmarks):
            self.sigma, self.landmarks = sigma, landmarks

        def example(self):
            return RangeBearingReadings(np.array([1]), np.ones(1, np.float32), np.zeros(1, np.float32))

        def admit(self, particles, weights, reading):
            return reading

        def log_likelihood(self, particles, reading):
            total = np.zeros(particles.shape[1], np.float32)
            for landmark, distance in zip(reading.landmarks.tolist(), reading.ranges):
                x, y = self.landmarks.position(landmark)
                expected = np.hypot(np.float32(x) - particles[0], np.float32(y) - particles[1])
                total -= np.float32(0.5) * ((distance - expected) / np.float32(self.sigma)) ** 2
            return total
"""
TICKS = 40
WORDS = (
    "landmark-room",
    "--set",
    f"max_ticks={TICKS}",
    "--set",
    "estimator.motion={kind='lab_of_mine:Walk', step=0.01}",
    "--set",
    "estimator.measurement={kind='lab_of_mine:Ranges', sigma=0.1}",
)


def test_a_users_models_run_on_the_bus_inline_and_in_a_replay(tmp_path, dynpf, here, monkeypatch):
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "lab_of_mine.py").write_text(dedent(LAB), encoding="utf-8")
    on_bus, inline = tmp_path / "bus.mcap", tmp_path / "inline.mcap"
    run = dynpf("run", *WORDS, "--json", "-o", on_bus, modules=lab)
    assert run.wait() == 0, run.stderr
    assert json.loads(run.stdout)["position_rmse_m"] < 0.2

    monkeypatch.syspath_prepend(str(lab))
    assert here("run", *WORDS, "--runner", "inline", "-o", inline).code == 0
    assert content_digest(read_recording(inline)) == content_digest(read_recording(on_bus))
    replayed = here("replay", on_bus, "--json", "--allow-code", "lab_of_mine")
    assert replayed.code == 0, replayed.out
    assert json.loads(replayed.out)["counts"]["estimator"]["steps"] == TICKS

    without = dynpf("replay", on_bus, "--allow-code", "lab_of_mine")
    assert without.wait() == 2
    assert_told(without.stderr)
    # Processes that need none of it do not ask for it, and what it was made with stays told.
    part = tmp_path / "part.mcap"
    assert here("replay", on_bus, "--node", "simulator", "-o", part).code == 0
    assert recorded_digests(part) == recorded_digests(on_bus)


def test_a_module_that_is_not_on_the_path_is_told_in_one_line(tmp_path, dynpf):
    path = tmp_path / "run.mcap"
    run = dynpf("run", *WORDS, "-o", path)
    assert run.wait() == 2
    assert_told(run.stderr)
    assert not path.exists()


def recorded_digests(path):
    return json.loads(read_recording(path).header.scenario)["user_code"]


def assert_told(words: str) -> None:
    (line,) = words.splitlines()
    assert "'lab_of_mine:" in line
    assert (
        "no module 'lab_of_mine' is beside the scenario or on the Python path; --code FOLDER names its folder" in line
    )


THREADED = """
    import threading

    from dynpf_lab import Node

    worker = threading.Thread(target=threading.Event().wait, daemon=True)
    worker.start()

    class Threaded(Node, frozen=True, kw_only=True):
        reads = ("truth/robot",)

        def step(self, state, moment):
            assert worker.is_alive()
            return state, ()
"""


def test_where_a_module_has_begun_threads_each_process_has_them(tmp_path, dynpf):
    """A copy of the starting process would lack them, and wait for what they hold."""
    (tmp_path / "threaded.py").write_text(dedent(THREADED), encoding="utf-8")
    own = ("--code", tmp_path, "--set", "nodes.watcher={kind='threaded:Threaded'}", "--set", "max_ticks=3")
    run = dynpf("run", "landmark-room", *own, "-o", tmp_path / "run.mcap")
    assert run.wait() == 0, run.stderr


SCRIPT = """
    import sys
    import threading

    from dynpf_lab.cli.main import main

    threading.Thread(target=threading.Event().wait, daemon=True).start()
    sys.exit(main(["run", "landmark-room", "--set", "max_ticks=3", "-o", sys.argv[1]]))
"""


def test_a_script_with_threads_runs_a_scenario_and_is_executed_once(tmp_path):
    """Processes started afresh must not execute the script of their parent again."""
    (tmp_path / "script.py").write_text(dedent(SCRIPT), encoding="utf-8")
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "run.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    end = read_recording(tmp_path / "run.mcap").end
    assert end is not None
    assert end.complete
