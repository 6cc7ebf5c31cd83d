"""The live page of a real run in Chromium: a robot is dragged, the run is paused and stepped, and replays the same."""

import json
import re
import subprocess
from pathlib import Path

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_services.scenario.played_log import acts_of

from tests.browser.test_pages import HERE, command, packages
from tests.integration.processes import start, until

__all__ = ["packages"]

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]


def test_a_person_acts_on_a_run_by_its_live_page_and_the_recording_replays_the_same(
    packages: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert packages.is_dir()
    path = tmp_path / "run.mcap"
    run = start(tmp_path, "run", "landmark-room", "--watch", "-o", path)
    run.says("live page: http://127.0.0.1:")
    (address,) = re.findall(r"http://\S+", run.stderr)
    words = [command("node"), "live.mjs", command("chromium", "chromium-browser"), address]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=HERE, timeout=300)
    assert done.returncode == 0, (done.stderr, run.stderr)
    found = json.loads(done.stdout.splitlines()[-1])
    assert run.wait() == 0, run.stderr
    assert found["said"] == []
    assert found["stepped"] == 1
    assert found["over"] == "The run has ended: finished."
    for size in ("wide", "narrow"):
        assert found[size] == {"overflow": 0, "faults": []}
    recording = read_recording(path)
    acts = acts_of(recording)
    kinds = [act.topic for of_tick in acts.values() for act in of_tick]
    assert kinds.count("operator/place") == 1
    assert "operator/drive" in kinds
    capsys.readouterr()
    assert main(["replay", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["same"]
    until(lambda: not [*tmp_path.glob("dynpf-*")], "the run's folder is removed")
