"""Pages in Chromium, from file:// and without a network: a silent console, the robot where the recording says."""

import json
import shutil
import subprocess
from collections.abc import Mapping
from os import environ
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.cli.main import main
from dynpf_lab.notebook import read, run
from dynpf_lab.page import make_page
from dynpf_protocol.messages import RobotState
from dynpf_services.scenario.load import scenario_files

from tests.browser.likeness import ALIKE, keep, unlike
from tests.integration.processes import DATA

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SHOTS = HERE / "shots"
SIMULATED = tuple(file.stem for file in scenario_files() if "needs_log = true" not in file.read_text())
PLAYED = {"laser-log": "bag", "landmark-mrclam": "mrclam", "landmark-team": "team"}
SHOWN = ("room-scan", "parts-3-easy", "colon-case-5", "landmark-filters", "faults", "two")
"""Pages of which pictures are kept: the systems, several estimators, what went wrong, and two runs."""

COMBINATIONS = [(width, scheme) for width in (1400, 400) for scheme in ("light", "dark")]
PAGES = (*SIMULATED, "faults", "two")
LOGS = ("imported", *PLAYED)
TICKS = 21


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
    """Return recordings by name: the first ticks of every shipped scenario, of imported logs, and one with faults."""
    folder = tmp_path_factory.mktemp("runs")
    found = {name: folder / f"{name}.mcap" for name in SIMULATED}
    for name, path in found.items():
        run(name, settings={"max_ticks": TICKS}, path=path)
    found["other"] = folder / "other.mcap"
    run("landmark-room", settings={"max_ticks": TICKS, "estimator.n": 50}, path=found["other"])
    found["faults"] = Path(shutil.copy(ROOT / "recordings/faults.mcap", folder))
    return found | (played(folder) if DATA.is_dir() else {})


def played(folder: Path) -> dict[str, Path]:
    """Return an imported log, and the first ticks of the scenarios that play one."""
    bag, mrclam = DATA / "bags/uob_pioneer", DATA / "mrclam"
    words = {
        "bag": ["rosbag", str(bag / "simpath2.bag"), "--map", str(bag / "meeting.yaml")],
        "mrclam": ["mrclam", str(mrclam / "ds1_seed_60s")],
        "team": ["mrclam", str(mrclam / "ds7_5robots_30s"), "--robot", "all"],
    }
    logs = {name: folder / f"log-{name}.mcap" for name in words}
    for name, log in logs.items():
        assert main(["import", *words[name], "-o", str(log)]) == 0
    found = {name: folder / f"{name}.mcap" for name in PLAYED}
    for name, path in found.items():
        run(name, settings={"max_ticks": TICKS}, log=logs[PLAYED[name]], path=path)
    return {"imported": logs["bag"], **found}


class Looked(NamedTuple):
    """What the browser found on each page, and the folder with its pictures."""

    pages: dict[str, Any]
    shots: Path


@pytest.fixture(scope="module")
def looked(packages: Path, recordings: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Looked:
    """Look at the page of each recording, and at that of two."""
    assert packages.is_dir()
    pages = {name: [read_recording(path)] for name, path in recordings.items() if name != "other"}
    pages["two"] = [read_recording(recordings[name]) for name in ("landmark-room", "other")]
    folder = recordings["faults"].parent
    files = {name: folder / f"{'shown-' if name in SHOWN else 'page-of-'}{name}.html" for name in pages}
    for name, runs in pages.items():
        make_page(runs, files[name])
    shots = tmp_path_factory.mktemp("shots")
    chromium = command("chromium", "chromium-browser")
    words: list[str | Path] = [command("node"), HERE / "pages.mjs", chromium, shots, *files.values()]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=HERE)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    return Looked({name: told[str(file)] for name, file in files.items()}, shots)


def page_in(looked: Looked, name: str) -> dict[str, Any]:
    """Return what was found on a page; that of a log is not there without the data."""
    if name not in looked.pages:
        pytest.skip(f"{DATA} is not here")
    found: dict[str, Any] = looked.pages[name]
    return found


@pytest.mark.parametrize("name", [*PAGES, *LOGS])
@pytest.mark.parametrize("size", ["wide", "narrow"])
def test_a_page_opens_in_silence_fits_and_has_no_serious_fault(looked: Looked, name: str, size: str) -> None:
    page = page_in(looked, name)[size]
    assert page["said"] == []
    assert page["overflow"] <= 0
    assert page["faults"] == []
    assert page["inked"] > 1000
    assert page["played"] != page["second"] != "0.00 s, tick 0"


@pytest.mark.parametrize("name", [name for name in PAGES if not name.startswith("colon")])
def test_the_slider_moves_the_robot_where_the_recording_says(
    looked: Looked, recordings: Mapping[str, Path], name: str
) -> None:
    truth = states(read_recording(recordings["landmark-room" if name == "two" else name]))
    moments = looked.pages[name]["wide"]["poses"]
    assert len({moment["time"] for moment in moments}) == 20
    for moment in moments:
        tick = int(moment["time"].partition("tick ")[2])
        (row,) = [row["cells"] for row in moment["rows"] if row["role"] == "truth"]
        told = np.array([float(cell) for cell in row[1:4]])
        assert np.all(np.abs(told - truth[tick]) <= [6e-4, 6e-4, 0.06])


@pytest.mark.parametrize("name", SHOWN)
@pytest.mark.parametrize(("width", "scheme"), COMBINATIONS)
def test_a_page_looks_as_it_did(looked: Looked, name: str, width: int, scheme: str) -> None:
    shot = looked.shots / f"{name}-{width}-{scheme}.png"
    kept = SHOTS / f"{shot.stem}.jpg"
    if environ.get("DYNPF_KEEP_SHOTS"):
        keep(shot, kept)
    assert unlike(shot, kept) < ALIKE
    other = SHOTS / f"{SHOWN[SHOWN.index(name) - 1]}-{width}-{scheme}.jpg"
    assert unlike(shot, other) > ALIKE, "the control: another page looks otherwise"


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
