"""Projection and calibration: against OpenCV's camera model, exact round trips, and refusals."""

import cv2
import numpy as np
import pytest
from dynpf_systems.parts.camera_model import CameraParams, calibration_pairs, project
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import rng
from dynpf.vision import CalibrationError, Disc, PlaneProjection, calibrate, fit_circle

CAMERA = CameraParams()
CENTRE = (639.5, 511.5)


def grid(per_side: int = 5) -> np.ndarray:
    ticks = np.linspace(-0.95, 0.95, per_side)
    return np.stack(np.meshgrid(ticks, ticks), axis=2).reshape(-1, 2)


def test_the_simulated_camera_is_opencv_s_model() -> None:
    camera = CameraParams(tilt_x_rad=0.0, tilt_y_rad=0.0, rotation_rad=0.3, radial_distortion=-0.05)
    points = grid()
    matrix = np.array([[camera.focal_px, 0, CENTRE[0]], [0, camera.focal_px, CENTRE[1]], [0, 0, 1]])
    turned = cv2.Rodrigues(np.array([0.0, 0.0, 0.3]))[0]
    looking_down = cv2.Rodrigues(np.diag([1.0, -1.0, -1.0]) @ turned)[0]
    space = np.column_stack([points, np.zeros(len(points))])
    distortion = np.array([camera.radial_distortion, 0, 0, 0])
    expected = cv2.projectPoints(space, looking_down, np.array([0, 0, camera.height_m]), matrix, distortion)[0]
    assert project(points, camera) == pytest.approx(expected[:, 0], abs=1e-9)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.floats(-0.08, 0.08), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-3, 3))
def test_calibration_recovers_the_camera(distortion: float, tilt_x: float, tilt_y: float, turn: float) -> None:
    camera = CameraParams(
        radial_distortion=distortion, tilt_x_rad=tilt_x, tilt_y_rad=tilt_y, rotation_rad=turn, focal_px=1000.0
    )
    fitted = calibrate(project(grid(4), camera), grid(4))
    elsewhere = rng.generator(1, "test", 0).uniform(-1, 1, (50, 2))
    assert fitted.to_workspace(project(elsewhere, camera)) == pytest.approx(elsewhere, abs=1e-7)
    assert fitted.rms_px < 1e-4


def test_to_workspace_undoes_to_pixels_and_stays_finite_far_outside() -> None:
    identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for k in (-0.2, 0.0, 0.3):
        lens = PlaneProjection(homography=identity, radial_distortion=k, centre_px=(0.0, 0.0), scale_px=100.0)
        points = grid(9) * 0.8
        assert lens.to_workspace(lens.to_pixels(points)) == pytest.approx(points, abs=1e-9)
        assert np.isfinite(lens.to_workspace(np.array([[0.0, 0.0], [1e4, -1e4]]))).all()


def test_without_the_distortion_the_fit_is_worse() -> None:
    camera = CameraParams(radial_distortion=-0.06)
    fitted = calibrate(project(grid(), camera), grid())
    homography, _ = cv2.findHomography(project(grid(), camera), grid())
    flat = cv2.perspectiveTransform(project(grid(), camera)[None], homography)[0]
    assert np.abs(flat - grid()).max() > 1e-3 > 1e3 * fitted.rms_m


def test_noisy_pairs_leave_about_their_noise() -> None:
    pairs = np.array(calibration_pairs(CAMERA))
    noisy = pairs[:, :2] + 0.5 * rng.generator(1, "test", 0).standard_normal((len(pairs), 2))
    fitted = calibrate(noisy, pairs[:, 2:])
    assert 0.5 < fitted.rms_px < 0.75  # sqrt(2) * 0.5, less the nine fitted numbers
    assert fitted.to_workspace(pairs[:, :2]) == pytest.approx(pairs[:, 2:], abs=2e-3)


def test_six_pairs_are_enough_and_five_are_not() -> None:
    points = np.array([[-0.9, -0.8], [0.9, -0.9], [0.8, 0.9], [-0.8, 0.8], [0.1, 0.5], [0.3, -0.4]])
    px = project(points, CAMERA)
    assert calibrate(px, points).to_workspace(px) == pytest.approx(points, abs=1e-6)
    with pytest.raises(CalibrationError, match="at least 6 pairs, got 5"):
        calibrate(px[:5], points[:5])


LINE = np.stack([np.linspace(-1, 1, 8), np.linspace(-0.5, 0.5, 8)], axis=1)


@pytest.mark.parametrize(
    ("px", "metres", "complaint"),
    [
        (project(LINE, CameraParams(radial_distortion=0.0)), LINE, "lie on one line"),
        (np.ones((8, 2)), grid()[:8], "lie on one line"),
        (project(grid(), CAMERA)[:6], grid()[:7], "equal shapes"),
        (np.full((8, 2), np.nan), grid()[:8], "finite"),
        (
            project(np.vstack([LINE, [[0.5, -0.5]]]), CameraParams(radial_distortion=0.0)),
            np.vstack([LINE, [[0.5, -0.5]]]),
            "do not fix the map",
        ),
    ],
)
def test_refuses_pairs_that_fix_no_map(px: np.ndarray, metres: np.ndarray, complaint: str) -> None:
    with pytest.raises(CalibrationError, match=complaint):
        calibrate(px, metres)


@pytest.mark.parametrize("subsampling", [1, 4])
def test_a_disc_comes_back_with_centre_and_radius(subsampling: int) -> None:
    fitted = calibrate(project(grid(), CAMERA), grid())
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = np.array([0.6, -0.7]) + 0.11 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    small = (project(rim, CAMERA) - (subsampling - 1) / 2) / subsampling
    u, v, radius, _ = fit_circle(small)
    seen = Disc(u, v, radius, -90.0, 0.0, 1.0)
    placed = fitted.disc_to_workspace(seen, subsampling)
    assert (placed.x, placed.y, placed.radius) == pytest.approx((0.6, -0.7, 0.11), abs=2e-5)
    assert fitted.discs_to_workspace([seen, seen], subsampling) == (placed, placed)
    assert fitted.discs_to_workspace([]) == ()
