"""The chain on drawn images whose truth is known below a pixel."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from dynpf_systems.parts.studies.disc_scenes import KINDS, draw_scene, score
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from dynpf import rng
from dynpf.vision import DetectionParams, Disc, detect_discs, subsample, to_full_px

SMARTIES = Path(__file__).parents[3] / "../shared/data/images/opencv_smarties.png"
OVERSAMPLING = 8

Circle = tuple[float, float, float]


def drawn(
    circles: list[Circle], inside: list[float], background: float = 200.0, shape: tuple[int, int] = (120, 160)
) -> np.ndarray:
    """Grey levels (H, W) of discs over a background, each pixel the mean of its area, slightly blurred."""
    fine = (np.arange(OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    y = (np.arange(shape[0])[:, None] + fine).reshape(-1, 1)
    x = (np.arange(shape[1])[:, None] + fine).reshape(1, -1)
    image = np.full((len(y), x.shape[1]), background)
    for (cx, cy, radius), level in zip(circles, inside, strict=True):
        image[(x - cx) ** 2 + (y - cy) ** 2 <= radius**2] = level
    blocks = image.reshape(shape[0], OVERSAMPLING, shape[1], OVERSAMPLING).mean(axis=(1, 3))
    return np.asarray(cv2.GaussianBlur(blocks, (0, 0), 0.5))


def as_grey(image: np.ndarray, noise: float = 0.0) -> np.ndarray:
    draws = rng.generator(5, "test", 0).standard_normal(image.shape)
    return np.clip(np.rint(image + noise * draws), 0, 255).astype(np.uint8)


def circles_of(discs: tuple[Disc, ...]) -> np.ndarray:
    return np.array([(disc.x_px, disc.y_px, disc.radius_px) for disc in discs])


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.floats(40, 41), st.floats(50, 51), st.floats(6, 14), st.sampled_from([60.0, 140.0, 250.0]))
def test_finds_a_disc_to_a_small_fraction_of_a_pixel(x: float, y: float, radius: float, level: float) -> None:
    discs = detect_discs(as_grey(drawn([(x, y, radius)], [level], 190.0)), DetectionParams())
    assert circles_of(discs) == pytest.approx(np.array([[x, y, radius]]), abs=0.03)
    assert discs[0].grey == pytest.approx(level - 190.0, abs=2.0)
    assert discs[0].arc_fraction == 1.0


@pytest.mark.parametrize("gap", [-0.3, 0.0, 0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("angle", [0.0, 0.4, 2.1])
def test_tells_discs_apart_that_touch_or_nearly_do(gap: float, angle: float) -> None:
    centre, radii = np.array([80.2, 60.4]), (11.6, 7.1)
    towards = np.array([np.cos(angle), np.sin(angle)])
    second = centre + (sum(radii) + gap) * towards
    third = centre - (11.6 + 9.3 + gap) * towards
    truth = [(*centre, 11.6), (*second, 7.1), (*third, 9.3)]
    discs = detect_discs(as_grey(drawn(truth, [60.0, 125.0, 125.0]), noise=1.5), DetectionParams())
    found = sorted(discs, key=lambda disc: disc.radius_px)
    assert circles_of(tuple(found)) == pytest.approx(np.array(sorted(truth, key=lambda circle: circle[2])), abs=0.1)


def test_tells_five_discs_apart_that_all_touch() -> None:
    radius, turn = 9.0, np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    triangles = 2 * radius * np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5], [1, 3**0.5]])
    truth = [(x, y, radius) for x, y in triangles @ turn.T + [70, 40]]
    discs = detect_discs(as_grey(drawn(truth, [110.0] * 5), noise=1.5), DetectionParams())
    expected = np.array(sorted(truth, key=lambda circle: (circle[1], circle[0])))
    assert circles_of(discs) == pytest.approx(expected, abs=0.2)


def test_uneven_light_moves_nothing() -> None:
    truth = [(20.3, 20.6, 8.0), (140.2, 100.7, 8.0), (80.5, 60.1, 11.0), (138.0, 17.3, 6.5)]
    flat = drawn(truth, [90.0] * 4)
    y, x = np.mgrid[-1 : 1 : flat.shape[0] * 1j, -1 : 1 : flat.shape[1] * 1j]
    light = (1 - 0.25 * (x**2 + y**2)) * (1 + 0.2 * x)
    discs = detect_discs(as_grey(flat * light, noise=1.0), DetectionParams())
    expected = np.array(sorted(truth, key=lambda circle: (circle[1], circle[0])))
    assert circles_of(discs) == pytest.approx(expected, abs=0.06)
    contrast = [disc.grey for disc in discs]
    assert np.ptp(contrast) < 0.06 * abs(np.mean(contrast))  # one paint is one grey wherever it lies
    assert np.ptp(light) > 0.5


def test_a_disc_cut_by_the_border_keeps_its_centre() -> None:
    truth = [(3.0, 60.0, 12.0), (80.0, 121.0, 12.0)]
    discs = detect_discs(as_grey(drawn(truth, [90.0, 90.0])), DetectionParams())
    assert circles_of(discs) == pytest.approx(np.array(truth), abs=0.15)
    assert all(0.3 < disc.arc_fraction < 0.7 for disc in discs)


def test_other_shapes_are_no_discs() -> None:
    image = drawn([(20.0, 20.0, 8.0)], [80.0])
    image[60:84, 20:44] = 80.0  # square
    image[60:72, 60:140] = 80.0  # bar
    ellipse = cv2.ellipse(np.zeros(image.shape, np.uint8), (110, 100), (22, 11), 20, 0, 360, 1, cv2.FILLED)
    image[ellipse > 0] = 80.0
    image[10:40, 100] = 80.0  # line
    discs = detect_discs(as_grey(cv2.GaussianBlur(image, (0, 0), 0.7), noise=1.0), DetectionParams())
    assert circles_of(discs) == pytest.approx(np.array([[20.0, 20.0, 8.0]]), abs=0.1)


def test_bounds_on_radius_and_contrast_hold() -> None:
    image = as_grey(drawn([(30, 30, 5), (70, 60, 9), (120, 60, 20)], [90.0, 90.0, 90.0]))
    found = detect_discs(image, DetectionParams(min_radius_px=7, max_radius_px=15))
    assert [round(disc.radius_px) for disc in found] == [9]
    assert detect_discs(image, DetectionParams(min_contrast=150)) == ()
    assert len(detect_discs(image, DetectionParams())) == 3


@pytest.mark.parametrize("level", [0, 1, 128, 255])
def test_an_empty_image_holds_nothing(level: int) -> None:
    assert detect_discs(np.full((256, 320), level, np.uint8), DetectionParams()) == ()


@settings(derandomize=True, deadline=None, max_examples=60)
@given(arrays.arrays(np.uint8, st.tuples(st.integers(1, 60), st.integers(1, 60))))
def test_no_image_is_too_strange(image: np.ndarray) -> None:
    detect_discs(image, DetectionParams())


@pytest.mark.parametrize("contrast", [20, 255])
def test_random_pixels_hold_nothing(contrast: int) -> None:
    for step in range(5):
        image = rng.generator(3, "test", step).integers(0, contrast + 1, (256, 320)).astype(np.uint8)
        assert detect_discs(image, DetectionParams()) == ()


def test_many_discs_are_found_and_clutter_holds_nothing() -> None:
    dot = drawn([(10.0, 10.0, 5.0)], [90.0], shape=(20, 20))
    assert len(detect_discs(as_grey(np.tile(dot, (12, 16))), DetectionParams())) == 192
    assert detect_discs(as_grey(np.tile(dot, (20, 20))), DetectionParams()) == ()


def test_same_image_same_discs_in_order() -> None:
    truth = [(120.0, 30.0, 8.0), (30.0, 30.5, 8.0), (80.0, 90.0, 10.0)]
    image = as_grey(drawn(truth, [90.0] * 3), noise=2.0)
    first, second = (detect_discs(image, DetectionParams()) for _ in range(2))
    assert first == second
    assert [(disc.y_px, disc.x_px) for disc in first] == sorted((disc.y_px, disc.x_px) for disc in first)


@pytest.mark.parametrize("image", [np.zeros((20, 20, 3), np.uint8), np.zeros((20, 20))])
def test_refuses_what_is_no_grey_image(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="grey image"):
        detect_discs(image, DetectionParams())


def test_subsampling_keeps_places() -> None:
    frame = np.repeat(as_grey(drawn([(201.3, 138.6, 40.0)], [90.0], shape=(240, 320)))[..., None], 3, axis=2)
    (disc,) = detect_discs(subsample(frame), DetectionParams())
    centre = to_full_px(np.array([disc.x_px, disc.y_px]))
    assert (*centre, 4 * disc.radius_px) == pytest.approx((201.3, 138.6, 40.0), abs=0.12)


TURNS: dict[str, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
    "as it is": lambda grey: grey,
    "upside down": lambda grey: grey[::-1],
    "on its side": np.rot90,
    "light on dark": lambda grey: 255 - grey,
}


@pytest.mark.parametrize("turn", TURNS)
def test_a_photograph_of_sweets(turn: str) -> None:
    if not SMARTIES.exists():
        pytest.skip(f"no photograph at {SMARTIES}")
    grey = cv2.imread(str(SMARTIES), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    discs = detect_discs(np.ascontiguousarray(TURNS[turn](np.asarray(grey, np.uint8))), DetectionParams())
    assert len(discs) == 14  # by eye: two touch, and three are cut, of which one shows a quarter in the corner
    assert all(24 < disc.radius_px < 30.5 for disc in discs)  # they are of one size
    assert sum(disc.arc_fraction < 0.5 for disc in discs) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_finds_the_discs_of_drawn_scenes_and_invents_none(kind: str) -> None:
    scenes = [draw_scene(kind, 4, number) for number in range(5)]
    scores = [score(scene, detect_discs(scene.image, DetectionParams())) for scene in scenes]
    found = np.concatenate([one.found for one in scores])
    errors = np.concatenate([scene_score.centre_error_px for scene_score in scores])[found]
    cut = np.concatenate([scene.cut for scene in scenes])
    assert found[~cut].all()
    assert found[cut].mean() > 0.8  # of some there is a sliver left, and a neighbour touches that
    assert sum(scene_score.false_discs for scene_score in scores) == 0
    assert np.sqrt((errors**2).mean()) < (0.25 if kind == "photograph" else 0.08)
    assert sum(int(scene.touching.sum()) for scene in scenes) >= 8
    assert sum(int(scene.cut.sum()) for scene in scenes) >= 4


def test_a_disc_in_another_place_or_of_another_size_does_not_count() -> None:
    scene = draw_scene("both", 3, 0)
    x, y, radius = (float(value) for value in scene.discs[0])
    for wrong in (Disc(x + 0.3 * radius, y, radius, 50.0, 0.0, 1.0), Disc(x, y, 0.7 * radius, 50.0, 0.0, 1.0)):
        assert score(scene, (wrong,)).false_discs == 1
    right = Disc(x, y, radius, 50.0, 0.0, 1.0)
    assert score(scene, (right, right)).false_discs == 1
    assert int(score(scene, (right, right)).found.sum()) == 1
