"""The simulated camera: the same bytes for the same key, and discs where the projection says."""

import cv2
import numpy as np
import pytest
from dynpf_systems.parts.camera import Camera, DrawnDisc, encode, render
from dynpf_systems.parts.camera_model import CameraParams, calibration_pairs, project

PARAMS = CameraParams()
QUIET = CameraParams(noise_std=0.0, light_falloff=0.0, light_slope=0.0)
SCENE = [
    DrawnDisc(0.3, -0.2, 0.10, PARAMS.robot_colour, 1.0),
    DrawnDisc(-0.4, 0.5, 0.07, PARAMS.part_colour),
    DrawnDisc(0.95, 0.95, 0.11, PARAMS.part_colour),
]


def test_same_seed_and_tick_same_bytes_and_another_differs() -> None:
    frame = render(SCENE, PARAMS, seed=3, tick=7)
    again = Camera(PARAMS).render(SCENE, seed=3, tick=7)
    assert frame.shape == (1024, 1280, 3)
    assert frame.dtype == np.uint8
    assert encode(frame, PARAMS) == encode(again, PARAMS)
    assert not np.array_equal(frame, render(SCENE, PARAMS, seed=3, tick=8))
    assert not np.array_equal(frame, render(SCENE, PARAMS, seed=4, tick=7))


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.85, 0.8), (-0.713, 0.342), (-0.9, -0.88)])
def test_a_disc_covers_the_image_of_its_area(x: float, y: float) -> None:
    radius = 0.09
    empty = render([], QUIET, 1, 1).astype(float)[..., 0]
    frame = render([DrawnDisc(x, y, radius, QUIET.part_colour)], QUIET, 1, 1).astype(float)[..., 0]
    cover = (empty - frame) / (QUIET.table_colour[0] - QUIET.part_colour[0])
    v, u = np.mgrid[: frame.shape[0], : frame.shape[1]]
    centroid = np.array([(u * cover).sum(), (v * cover).sum()]) / cover.sum()
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    rim = project(np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1), QUIET)
    polygon = cv2.moments((rim - rim[0]).astype(np.float32))
    expected = rim[0] + np.array([polygon["m10"], polygon["m01"]]) / polygon["m00"]
    assert centroid == pytest.approx(expected, abs=0.01)
    assert cover.sum() == pytest.approx(polygon["m00"], rel=2e-3)


def test_the_whole_workspace_is_in_view_with_room_around() -> None:
    side = np.linspace(-1, 1, 21)
    border = np.concatenate(
        [np.stack(pair, axis=1) for s in (-1, 1) for pair in ((side, 0 * side + s), (0 * side + s, side))]
    )
    px = project(border, PARAMS)
    assert px.min() > 5
    assert px[:, 0].max() < PARAMS.width_px - 5
    assert px[:, 1].max() < PARAMS.height_px - 5


def test_workspace_axes_are_not_mirrored() -> None:
    origin, right, up = project(np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]), PARAMS)
    assert right[0] - origin[0] > 200
    assert origin[1] - up[1] > 200  # rows run downwards


def test_noise_has_its_deviation_and_light_its_slope() -> None:
    quiet = CameraParams(light_falloff=0.0, light_slope=0.0, noise_std=3.0)
    patch = render([], quiet, 1, 1)[400:600, 500:800].astype(float)
    assert patch.std(axis=(0, 1)) == pytest.approx([3.0, 3.0, 3.0], rel=0.05)
    assert patch.mean(axis=(0, 1)) == pytest.approx(quiet.table_colour, abs=0.1)
    lit = render([], PARAMS, 1, 1).astype(float)
    assert lit[300:700, -60:].mean() > lit[300:700, :60].mean() + 10


def test_gripper_line_points_where_the_gripper_does() -> None:
    plain = render([DrawnDisc(0.1, 0.2, 0.1, QUIET.robot_colour)], QUIET, 1, 1).astype(float)
    lined = render([DrawnDisc(0.1, 0.2, 0.1, QUIET.robot_colour, 2.0)], QUIET, 1, 1).astype(float)
    v, u = np.nonzero((lined - plain).sum(axis=2) > 50)
    middle = project(np.array([[0.1 + 0.045 * np.cos(2.0), 0.2 + 0.045 * np.sin(2.0)]]), QUIET)[0]
    assert (u.mean(), v.mean()) == pytest.approx(tuple(middle), abs=0.6)


def test_a_disc_outside_the_view_leaves_the_frame_alone() -> None:
    assert np.array_equal(render([DrawnDisc(5.0, 0.0, 0.1, (0, 0, 0))], QUIET, 1, 1), render([], QUIET, 1, 1))


def test_encode_gives_a_jpeg_close_to_the_frame() -> None:
    frame = render(SCENE, PARAMS, 1, 1)
    data = encode(frame, PARAMS)
    back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert data[:2] == b"\xff\xd8"
    assert back is not None
    assert np.abs(back.astype(float) - frame).mean() < 3
    assert len(encode(frame, CameraParams(jpeg_quality=30))) < len(data)


def test_calibration_pairs_are_the_projection_of_a_grid() -> None:
    pairs = np.array(calibration_pairs(PARAMS, per_side=4))
    assert pairs.shape == (16, 4)
    assert pairs[:, :2] == pytest.approx(project(pairs[:, 2:], PARAMS))
    assert np.ptp(pairs[:, 2:], axis=0) == pytest.approx([1.8, 1.8])
