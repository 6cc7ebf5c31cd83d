"""All particles of a run, by executing its filters again: those recorded are some of them."""

from pathlib import Path

import numpy as np
import pytest
from dynpf_experiments.pictures.executed import executed_clouds, with_executed
from dynpf_experiments.pictures.source import Budget
from dynpf_experiments.pictures.whole import whole
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_lab.notebook import run
from dynpf_services.scenario.replay import scenario_of_replay

N = 700


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("executed") / "run.mcap"
    run("landmark-room", settings={"max_ticks": 30, "estimator.n": N}, path=path)
    return path


def test_the_recorded_particles_are_among_all_of_their_moment(recorded: Path) -> None:
    recording = read_recording(recorded)
    (told,) = whole(recording).clouds
    (found,) = executed_clouds(recording, scenario_of_replay(recording), Budget())
    assert (found.node, found.told) == (told.node, told.told)
    assert np.array_equal(found.seconds, told.seconds)
    for few, many in zip(told.points, found.points, strict=True):
        assert (few.shape, many.shape) == ((2, 200), (2, N))
        nearest = np.abs(few[:, :, None] - many[:, None]).max(axis=0).min(axis=1)
        assert nearest.max() <= 6e-4  # recorded to the millimetre
    assert with_executed([told], [found], 5)[0].seconds.size == 5


def test_a_page_of_all_particles_is_another_page_and_made_once(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = recorded.with_suffix(".html")
    texts = []
    for which in ("recorded", "all", "all"):
        assert main(["view", str(recorded), "--particles", which, "--no-open"]) == 0
        texts.append(page.read_text())
    capsys.readouterr()
    assert texts[1] == texts[2]
    assert len(texts[1]) > len(texts[0]) + 20_000
