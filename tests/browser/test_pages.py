"""Pages in Chromium, from file:// and without a network: a silent console, the robot where the recording says."""

import json
import shutil
import subprocess
from collections.abc import Mapping
from os import environ
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.notebook import read, run
from dynpf_lab.page import make_page
from dynpf_protocol.messages import RobotState

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
RUNS = {"indoor-tracking": {"max_ticks": 20}, "room-scan": {"max_ticks": 40}}
RECORDED = ("camera", "colon", "faults", "landmarks", "rearrangement")


def command(name: str, *others: str) -> str:
    """Return a program's path; in CI it has to be there."""
    found = next(filter(None, map(shutil.which, (name, *others))), None)
    if found is None:
        reason = f"{name} is not installed; as root, .ci/browser --install may help"
        pytest.fail(reason) if environ.get("CI") == "true" else pytest.skip(reason)
    return str(found)


@pytest.fixture(scope="module")
def packages() -> Path:
    """Return where the npm packages are that the lock file names."""
    npm = command("npm")
    subprocess.run(
        [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund"], check=True, cwd=HERE, capture_output=True
    )
    return HERE / "node_modules"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return recordings by name: short runs with maps, and the reference recordings."""
    folder = tmp_path_factory.mktemp("runs")
    found = {name: folder / f"{name}.mcap" for name in RUNS}
    for name, settings in RUNS.items():
        run(name, settings=settings, path=found[name])
    return found | {name: Path(shutil.copy(ROOT / f"recordings/{name}.mcap", folder)) for name in RECORDED}


@pytest.fixture(scope="module")
def found(packages: Path, recordings: Mapping[str, Path]) -> dict[str, Any]:
    """Return what the browser found on the page of each recording, and on that of two."""
    assert packages.is_dir()
    pages = {name: [read_recording(path)] for name, path in recordings.items()}
    pages["two"] = [read_recording(recordings[name]) for name in ("landmarks", "faults")]
    files = {name: recordings["faults"].with_name(f"page-of-{name}.html") for name in pages}
    for name, runs in pages.items():
        make_page(runs, files[name])
    words: list[str | Path] = [
        command("node"),
        HERE / "pages.mjs",
        command("chromium", "chromium-browser"),
        *files.values(),
    ]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=HERE)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    return {name: told[str(file)] for name, file in files.items()}


PAGES = (*RUNS, *RECORDED, "two")


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("size", ["wide", "narrow"])
def test_a_page_opens_in_silence_fits_and_has_no_serious_fault(found: dict[str, Any], name: str, size: str) -> None:
    page = found[name][size]
    assert page["said"] == []
    assert page["overflow"] <= 0
    assert page["faults"] == []
    assert page["inked"] > 1000
    assert page["played"] != page["second"] != "0.00 s, tick 0"


@pytest.mark.parametrize("name", ["room-scan", "landmarks", "rearrangement", "two"])
def test_the_slider_moves_the_robot_where_the_recording_says(
    found: dict[str, Any], recordings: Mapping[str, Path], name: str
) -> None:
    recording = read_recording(recordings["landmarks" if name == "two" else name])
    truth = states(recording)
    moments = found[name]["wide"]["poses"]
    assert len({moment["time"] for moment in moments}) == 20
    for moment in moments:
        tick = int(moment["time"].partition("tick ")[2])
        (row,) = [row["cells"] for row in moment["rows"] if row["role"] == "truth"]
        told = np.array([float(cell) for cell in row[1:4]])
        assert np.all(np.abs(told - truth[tick]) <= [6e-4, 6e-4, 0.06])


def states(recording: Recording) -> dict[int | None, np.ndarray[Any, Any]]:
    """Return the true poses by tick: m, m, degrees."""
    messages = zip(recording.messages("truth/robot"), read(recording.path)["truth/robot"], strict=True)
    return {
        recording.tick_of(record): np.array([state.x, state.y, np.degrees(state.theta)])
        for record, (_, state) in messages
        if isinstance(state, RobotState)
    }


def test_the_pure_parts_of_the_script(packages: Path) -> None:
    assert packages.is_dir()
    words = [command("node"), "--test", "js/"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=HERE)
    assert done.returncode == 0, done.stdout
    assert "# fail 0" in done.stdout
