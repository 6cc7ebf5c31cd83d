"""Bitmaps of one's own as COLON's tube: what is refused, where they are looked for, and that a recording holds them."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import SCENARIOS, load_scenario
from dynpf_systems.colon.tube import colon_world

DRAWN = np.asarray(cv2.imread(str(SCENARIOS / "maps" / "own-a.png"), cv2.IMREAD_GRAYSCALE), np.uint8)
WHITE = 238


@pytest.fixture(name="drawings")
def write_drawings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Right ones and wrong ones, in the current folder."""
    for letter in "ab":
        shutil.copy(SCENARIOS / "maps" / f"own-{letter}.png", tmp_path / f"{letter}.png")
    cut, barred = DRAWN.copy(), DRAWN.copy()
    cut[:, 300:330] = WHITE
    barred[:, 250:256] = 0
    (tmp_path / "more").mkdir()
    for name, pixels in {
        "a.bmp": DRAWN,
        "a.pgm": DRAWN,
        "cut.png": cut,
        "barred.png": barred,
        "black.png": np.zeros_like(DRAWN),
        "larger.png": np.pad(DRAWN, 9, constant_values=WHITE),
        "more/a.png": np.pad(DRAWN, ((0, 9), (0, 0)), constant_values=WHITE),
    }.items():
        assert cv2.imwrite(str(tmp_path / name), pixels)
    (tmp_path / "text.png").write_text("no image")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("maps", "said"),
    [
        (["a.png", "cut.png"], "maps: cut.png: the tube around the route is not closed"),
        (["barred.png", "b.png"], "maps: barred.png: the route meets a wall at (249, 155)"),
        (["black.png", "b.png"], "maps: black.png: no free space in 680 x 500 cells"),
        (["text.png", "b.png"], "maps: text.png: 8 bytes that do not decode"),
        (["a.png", "none.png"], "none.png' cannot be read: No such file or directory"),
        (["a.png", "more/a.png"], "maps: two files are called a.png"),
        (["a.png"], "colon.true: map 'b': the bitmaps of this run are called a"),
        (["a.png", "larger.png"], "estimator: the maps a, b differ in size"),
    ],
)
def test_a_wrong_drawing_is_refused_in_one_line_before_the_run(
    maps: list[str], said: str, drawings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "colon-own-maps", "--set", f"maps={maps}", "-o", "run.mcap"]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert not (drawings / "run.mcap").exists()


def test_a_route_that_does_not_fit_is_refused(drawings: Path) -> None:
    with pytest.raises(ScenarioError, match=r"maps: own-a.png: the route comes to \(680, 187\), outside of the map's"):
        load_scenario("colon-own-maps", overrides=["colon.route.motions=[[600, 0.75]]"])


def test_paths_are_seen_from_where_they_were_written(drawings: Path) -> None:
    ours = load_scenario("colon-own-maps")
    assert ours.maps == ("own-a.png", "own-b.png")
    given = load_scenario("colon-own-maps", overrides=["maps=['a.png','b.png']"])
    assert given.maps == ("a.png", "b.png")
    assert [given.files[name].sha256 for name in given.maps] == [ours.files[name].sha256 for name in ours.maps]
    one = load_scenario("colon-own-maps", overrides=["maps.0=a.pgm"])
    assert one.maps == ("a.pgm", "own-b.png")


def test_bitmaps_need_a_tube_to_be() -> None:
    with pytest.raises(ScenarioError, match=r"maps: bitmaps for the tube of \[colon\], which this run lacks"):
        load_scenario("landmark-room", overrides=["maps=['a.png']"])


def test_one_drawing_in_several_formats_is_one_map(drawings: Path) -> None:
    grids = []
    for name in ("a.png", "a.bmp", "a.pgm", "b.png"):
        world = colon_world(
            Context(load_scenario("colon-own-maps", overrides=[f"maps=['{name}','b.png']"]), "simulator")
        )
        grids.append(world.grid("a", "").cells)
    np.testing.assert_array_equal(grids[0], grids[1])
    np.testing.assert_array_equal(grids[0], grids[2])
    assert np.sum(grids[0] != grids[3]) > 1000


def test_a_recording_is_run_again_without_the_files(drawings: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--set", "maps=['a.bmp','b.png']", "--runner", "inline", "-o", "run.mcap"]
    assert main(["run", "colon-own-maps", *words]) == 0
    moved = drawings / "more" / "run.mcap"
    shutil.move("run.mcap", moved)
    for path in drawings.glob("*.*"):
        path.unlink()
    capsys.readouterr()
    assert main(["replay", str(moved)]) == 0
    assert main(["metrics", str(moved)]) == 0
    assert "probability of the true one at the end 0.9" in capsys.readouterr().out
    assert main(["replay", str(moved), "--set", "sensors.sigma_range_px=4.0"]) == 1
