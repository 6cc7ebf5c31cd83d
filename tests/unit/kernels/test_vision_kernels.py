"""The kernels of vision and of the camera against NumPy, SciPy and OpenCV."""

from typing import Any

import cv2
import numpy as np
import pytest
from scipy.optimize import brentq, least_squares

from dynpf import kernels, rng
from dynpf.types import Float32s, FloatArray
from dynpf.vision.background import _exponents, _terms


def noisy_arcs(seed: int, count: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (D, K, 2) on arcs, a tenth of a unit off, and weights (D, K) of which a third is zero."""
    random = rng.generator(seed, "test", 0)
    angles = random.uniform(0.0, 6.0, (count, 1)) + random.uniform(1.0, 6.0, (count, 1)) * random.random((count, size))
    radii, centres = random.uniform(2.0, 30.0, (count, 1, 1)), random.uniform(-50.0, 300.0, (count, 1, 2))
    points = centres + radii * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    points += 0.1 * random.standard_normal(points.shape)
    return points, np.maximum(random.uniform(-0.5, 1.0, (count, size)), 0.0)


def test_the_algebraic_fit_is_the_smallest_eigenvector_of_the_moments() -> None:
    points, weights = noisy_arcs(1, 20, 40)
    found = np.empty((20, 3))
    kernels.circles.fit_algebraic(points, weights, found)
    for own, weight, circle in zip(points, weights, found, strict=True):
        share = weight / weight.sum()
        mean = share @ own
        centred = own - mean
        z = (centred**2).sum(axis=1)
        scale = 2.0 * np.sqrt(share @ z)
        columns = np.column_stack([(z - share @ z) / scale, centred])
        smallest = np.linalg.eigh(columns.T @ (share[:, None] * columns))[1][:, 0]
        offset = -smallest[1:] * scale / (2.0 * smallest[0])
        expected = [*(mean + offset), np.sqrt(offset @ offset + share @ z)]
        assert circle == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_the_geometric_fit_is_the_least_squares_solution_of_each_circle() -> None:
    points, weights = noisy_arcs(2, 12, 30)
    start, found, residuals = np.empty((12, 3)), np.empty((12, 3)), np.empty(12)
    kernels.circles.fit_algebraic(points, weights, start)
    found[:] = start
    kernels.circles.fit_geometric(points, weights, found, residuals)
    for own, weight, first, circle, residual in zip(points, weights, start, found, residuals, strict=True):
        best = least_squares(
            lambda guess, own=own, weight=weight: (
                np.sqrt(weight) * (np.linalg.norm(own - guess[:2], axis=1) - guess[2])
            ),
            first,
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        assert circle == pytest.approx(best.x, abs=1e-5)
        assert residual == pytest.approx(np.sqrt(2.0 * best.cost / weight.sum()), rel=1e-9)
    assert np.abs(found - start).max() > 1e-3  # the start alone is not the solution


def test_a_circle_depends_on_its_own_points_alone() -> None:
    points, weights = noisy_arcs(3, 6, 25)
    together, residuals = np.empty((6, 3)), np.empty(6)
    kernels.circles.fit_algebraic(points, weights, together)
    kernels.circles.fit_geometric(points, weights, together, residuals)
    alone, residual = np.empty((1, 3)), np.empty(1)
    kernels.circles.fit_algebraic(points[4:5].copy(), weights[4:5].copy(), alone)
    kernels.circles.fit_geometric(points[4:5].copy(), weights[4:5].copy(), alone, residual)
    assert alone[0].tobytes() == together[4].tobytes()
    assert residual[0] == residuals[4]


@pytest.mark.parametrize(("shape", "spacing"), [((256, 320), 9), ((17, 16), 1), ((40, 33), 2)])
def test_samples_of_the_background_are_opencv_s_blur(shape: tuple[int, int], spacing: int) -> None:
    grey = rng.generator(4, "test", 0).integers(0, 256, shape).astype(np.uint8)
    expected = cv2.blur(grey, (3, 3))[spacing // 2 :: spacing, spacing // 2 :: spacing].ravel()
    found = np.empty(expected.size)
    kernels.background.sample(grey, spacing, found)
    assert (found == expected).all()


def test_the_light_is_the_least_squares_polynomial_through_what_does_not_stand_out() -> None:
    random, shape, degree = rng.generator(5, "test", 0), (60, 90), 3
    terms = _terms(*shape, 2, degree)
    truth = np.array([150.0, 20.0, -12.0, 9.0, 5.0, -7.0, 3.0, 2.0, -4.0, 1.0])
    values = terms @ truth + random.uniform(-0.5, 0.5, len(terms))
    dark = random.random(len(terms)) < 0.2
    values[dark] -= 80.0
    found = np.empty(len(truth))
    kernels.background.fit(terms, values, degree, found)
    expected = np.linalg.lstsq(terms[~dark], values[~dark], rcond=None)[0]
    assert found == pytest.approx(expected, abs=1e-8)

    matrix = np.zeros((degree + 1, degree + 1))
    for (i, j), value in zip(_exponents(degree), found, strict=True):
        matrix[i, j] = value
    y, x = np.linspace(-1.0, 1.0, 5), np.linspace(-3.0, 3.0, 7)
    surface = np.empty((5, 7), dtype=np.float32)
    powers_y, powers_x = np.vander(y, degree + 1, increasing=True), np.vander(x, degree + 1, increasing=True)
    kernels.background.surface(matrix, powers_y, np.ascontiguousarray(powers_x.T), surface)
    level = np.polynomial.polynomial.polygrid2d(y, x, matrix)
    assert surface == pytest.approx(np.clip(level, 0.0, 255.0), rel=1e-6)


def test_an_edge_lies_where_a_straight_fall_has_half_its_height() -> None:
    """A disc of contrast 80 whose rim falls over two pixels, seen on each ray as a line."""
    y, x = np.mgrid[:64, :80]
    circle = np.array([[40.3, 31.6, 14.2]])
    distance = np.hypot(x - circle[0, 0], y - circle[0, 1])
    image = (80.0 * np.clip((circle[0, 2] + 1.0 - distance) / 2.0, 0.0, 1.0)).astype(np.float32)
    angles = np.arange(32) * (2.0 * np.pi / 32)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points, falls = np.empty((1, 32, 2)), np.empty((1, 32))
    visible, found = np.empty((2, 1, 32), dtype=np.bool_)
    given = circle + np.array([[0.4, -0.3, 0.2]])
    search = (3.0, 0.5, 3, 0.25, 2.5)
    apart = np.zeros((1, 1), dtype=np.bool_)
    kernels.edges.rims(image, given, np.array([80.0]), rays, search, apart, points, visible, found, falls)
    assert found.all()
    assert visible.all()
    # The slope is half a pixel's: sigma is that of a Gaussian with it, whose pull on the edge is undone.
    inset = (2.0 / np.sqrt(2.0 * np.pi)) ** 2 / (2.0 * given[0, 2])
    off = np.linalg.norm(points[0] - given[0, :2], axis=1) - inset
    rim = given[0, :2] + off[:, None] * rays
    assert np.linalg.norm(rim - circle[0, :2], axis=1) == pytest.approx(np.full(32, circle[0, 2]), abs=0.08)
    grid = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, -0.5], [3.0, 0.0], [9.0, 9.0]])
    inner = np.empty(1)
    kernels.edges.inner_contrasts(image, circle, grid, inner)
    assert inner[0] == pytest.approx(80.0)


@pytest.mark.parametrize("distortion", [-0.2, 0.0, 0.3])
def test_undistorted_radii_solve_the_lens_equation(distortion: float) -> None:
    random = rng.generator(6, "test", 0)
    x, y = random.uniform(-0.6, 0.6, (2, 200))
    ideal_x, ideal_y = x.copy(), y.copy()
    kernels.calibration.undistort(ideal_x, ideal_y, distortion)
    for n in range(0, 200, 20):
        radius = np.hypot(x[n], y[n])
        root = brentq(lambda r, radius=radius: r * (1.0 + distortion * r * r) - radius, 0.0, 1.29, xtol=1e-15)
        assert np.hypot(ideal_x[n], ideal_y[n]) == pytest.approx(root, rel=1e-12)
        assert ideal_x[n] * y[n] == pytest.approx(ideal_y[n] * x[n])


def test_the_camera_s_parameters_are_the_least_squares_solution() -> None:
    random = rng.generator(7, "test", 0)
    truth = np.array([0.9, 0.05, 0.02, -0.04, -0.95, 0.01, 0.03, -0.02, -0.06])
    plane = random.uniform(-1.0, 1.0, (30, 2))

    def seen(parameters: FloatArray) -> Any:
        u, v, w = np.append(parameters[:8], 1.0).reshape(3, 3) @ np.vstack([plane.T, np.ones(30)])
        ideal = np.stack([u / w, v / w], axis=1)
        return ideal * (1.0 + parameters[8] * (ideal**2).sum(axis=1, keepdims=True))

    image = seen(truth) + 0.002 * random.standard_normal((30, 2))
    start = np.append(truth[:8] + 0.01, 0.0)
    best = least_squares(lambda guess: (seen(guess) - image).ravel(), start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = start.copy()
    kernels.calibration.refine(found, plane, image)
    assert found == pytest.approx(best.x, abs=1e-6)


def test_drawn_shapes_are_those_of_numpy_whatever_the_alignment() -> None:
    random, shape = rng.generator(8, "test", 0), (40, 50)
    y, x = (0.1 * axis.astype(np.float32) for axis in np.mgrid[:40, :50])
    light = random.uniform(0.7, 1.0, shape).astype(np.float32)
    profile = np.linspace(1.0, 0.0, 65).astype(np.float32)
    edge, colour = (np.float32(2.0), np.float32(16.0), profile), np.array([60, 110, 190], dtype=np.float32)
    empty = random.integers(0, 256, (*shape, 3)).astype(np.uint8)
    disc, line = (
        np.array(values, dtype=np.float32) for values in ((2.53, 2.11, 1.2), (2.5, 2.1, 0.8, 0.6, 0.3, 1.1, 1.0))
    )

    def painted(outside: Float32s) -> Any:
        index = np.clip((outside + np.float32(2.0)) * np.float32(16.0), 0.0, 64.0) + np.float32(0.5)
        cover = profile[index.astype(int)][..., None]
        lit = light[..., None] * colour
        return (empty + cover * (lit - empty) + np.float32(0.5)).astype(np.uint8)

    dx, dy = x - disc[0], y - disc[1]
    of_disc = painted((np.sqrt(dx * dx + dy * dy) - disc[2]) * np.float32(10.0))
    dx, dy = x - line[0], y - line[1]
    along = np.clip(dx * line[2] + dy * line[3], line[4], line[5])
    dx, dy = dx - along * line[2], dy - along * line[3]
    of_line = painted(np.sqrt(dx * dx + dy * dy) * np.float32(10.0) - line[6])
    assert (of_disc != empty).any()
    assert (of_line != empty).any()
    for offset in range(0, 64, 4):
        places = []
        for axis in (x, y):
            room = np.empty(axis.nbytes + 128, dtype=np.uint8)
            room = room[-room.ctypes.data % 64 + offset :][: axis.nbytes].view(np.float32).reshape(shape)
            room[:] = axis
            places.append(room)
        for draw, what, expected in (
            (kernels.drawing.draw_disc, disc, of_disc),
            (kernels.drawing.draw_line, line, of_line),
        ):
            frame = empty.copy()
            draw(frame, *places, light, (0, 40, 0, 50), what, np.float32(10.0), edge, colour)
            assert (frame == expected).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_noise_is_added_without_running_over(sign: int) -> None:
    random = rng.generator(9, "test", 0)
    frame = random.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    noise = random.integers(-220, 221, (25, 40, 3)).astype(np.int16)
    expected = np.clip(frame.astype(int) + sign * noise[3:23, 6:36], 0, 255)
    kernels.drawing.add_noise(frame, noise, 3, 6, sign)
    assert (frame == expected).all()


def test_bounds_of_a_disc_point_away_from_others_and_the_walls() -> None:
    random = rng.generator(10, "test", 0)
    centre, others, radii = random.uniform(-1, 1, 2), random.uniform(-1, 1, (5, 2)), random.uniform(0.05, 0.1, 5)
    rows, clearances = np.empty((9, 2)), np.empty(9)
    kernels.clearance.disc_bounds(centre, 0.1, others, radii, np.array([1.0, 0.8]), rows, clearances)
    distances = np.linalg.norm(centre - others, axis=1)
    assert clearances[:5] == pytest.approx(distances - radii - 0.1)
    assert rows[:5] == pytest.approx((centre - others) / distances[:, None])
    x, y = centre
    assert clearances[5:] == pytest.approx([1.0 - x - 0.1, 0.8 - y - 0.1, 1.0 + x - 0.1, 0.8 + y - 0.1])
    assert rows[5:].tolist() == [[-1.0, 0.0], [0.0, -1.0], [1.0, 0.0], [0.0, 1.0]]
