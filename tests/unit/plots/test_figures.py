"""Figures show what the recording says, and files of them are what their endings say."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from dynpf_experiments.messages import recorded as messages_of
from dynpf_experiments.pictures.whole import Whole, whole
from dynpf_experiments.plots.figures import FIGURES, figure, save
from dynpf_lab.cli.main import main
from dynpf_lab.cli.plot import NAMES
from dynpf_lab.plots import Plots
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import RobotState

from tests.unit.page.runs import recorded, short_run

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def room() -> Whole:
    return whole(short_run("room-scan", 60))


def test_the_true_path_is_drawn_where_it_was(room: Whole) -> None:
    axes = figure(room, "trajectory").axes[0]
    (line,) = [line for line in axes.lines if line.get_label() == "true path"]
    states = [timed.message for timed in messages_of(room.source.recording).topic("truth/robot")]
    expected = np.array([(state.x, state.y) for state in states if isinstance(state, RobotState)])
    assert np.allclose(line.get_xydata(), expected)
    low, high = axes.get_xlim()
    assert low < expected[:, 0].min() < expected[:, 0].max() < high


def test_the_command_and_the_notebook_have_every_figure() -> None:
    assert tuple(FIGURES) == NAMES
    assert {*FIGURES} <= {name for name in vars(Plots) if not name.startswith("_")}


@pytest.mark.parametrize("name", FIGURES)
def test_each_figure_has_lines_and_units(room: Whole, name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn = figure(room, name)
    assert all(axes.has_data() for axes in drawn.axes if axes.axison)
    assert any(axes.get_xlabel() in ("x (m)", "time (s)") for axes in drawn.axes)


@pytest.mark.parametrize("name", ["colon", "rearrangement"])
def test_worlds_of_other_systems_are_drawn_too(name: str) -> None:
    axes = figure(whole(recorded(name)), "trajectory").axes[0]
    assert axes.has_data()
    assert len(axes.lines) + len(axes.patches) + len(axes.images) >= 3


def test_what_a_run_has_not_is_said(room: Whole) -> None:
    with pytest.raises(UsageError, match="no node of the run says"):
        figure(whole(recorded("colon")), "health")
    with pytest.raises(UsageError, match="no such figure; there are overview"):
        figure(room, "portrait")


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_the_same_run_gives_the_same_file(room: Whole, tmp_path: Path, suffix: str, magic: bytes) -> None:
    first, second = (tmp_path / f"{name}{suffix}" for name in ("a", "b"))
    for path in (first, second):
        save(room, "trajectory", path)
    assert first.read_bytes().startswith(magic)
    assert first.read_bytes() == second.read_bytes()
    save(whole(short_run("room-scan", 61)), "trajectory", second)
    assert first.read_bytes() != second.read_bytes(), "one tick more is another picture"


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_film_moves(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    save(whole(short_run("landmark-room", 12)), "overview", path)
    film = cv2.VideoCapture(str(path))
    pictures = []
    while True:
        there, picture = film.read()
        if not there:
            break
        pictures.append(picture)
    assert len(pictures) >= 10
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("-o", "x.jpg"), "ends in '.jpg'; expected one of .png, .svg, .pdf, .gif, .mp4"),
        (("-o", "x.gif", "--figure", "errors"), "takes no --figure"),
        (("-o", "nowhere/x.png"), "there is no folder"),
    ],
)
def test_wrong_files_are_told(words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", "recordings/landmarks.mcap", *words]) == 2
    assert told in capsys.readouterr().err
