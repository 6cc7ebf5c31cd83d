"""Ray casting: closed forms, and brute force that shares no formula with it."""

import math

import numpy as np
import pytest

from dynpf.measurement.ray import ray_discs, ray_segments

SQUARE = np.array([(-1.0, -1.0, 1.0, -1.0), (1.0, -1.0, 1.0, 1.0), (1.0, 1.0, -1.0, 1.0), (-1.0, 1.0, -1.0, -1.0)])
ORIGIN = np.zeros(2)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0, 1.0), (60, 1 / math.sin(math.pi / 3)), (45, math.sqrt(2)), (-150, 1 / math.cos(math.pi / 6))],
)
def test_square_room_has_the_closed_form(degrees: float, expected: float) -> None:
    assert ray_segments(ORIGIN, np.radians([degrees]), SQUARE)[0] == pytest.approx(expected, rel=1e-14)


def test_a_ray_never_slips_through_a_corner() -> None:
    rng = np.random.default_rng(1)
    for origin in rng.uniform(-0.99, 0.99, (500, 2)):
        corners = SQUARE[:, :2] - origin
        ranges = ray_segments(origin, np.arctan2(corners[:, 1], corners[:, 0]), SQUARE)
        np.testing.assert_allclose(ranges, np.hypot(*corners.T), rtol=1e-9)


def test_segments_agree_with_a_linear_solve_for_each_pair() -> None:
    rng = np.random.default_rng(2)
    segments = rng.uniform(-3, 3, (12, 4))
    angles = rng.uniform(-math.pi, math.pi, 200)
    origin = rng.uniform(-3, 3, 2)
    expected = np.full(len(angles), np.inf)
    for beam, angle in enumerate(angles):
        for x1, y1, x2, y2 in segments:
            matrix = np.array([[math.cos(angle), x1 - x2], [math.sin(angle), y1 - y2]])
            distance, fraction = np.linalg.solve(matrix, np.array([x1, y1]) - origin)
            if distance >= 0 and 0 <= fraction <= 1:
                expected[beam] = min(expected[beam], distance)
    assert np.isfinite(expected).sum() > 50
    assert np.isinf(expected).sum() > 0
    np.testing.assert_allclose(ray_segments(origin, angles, segments), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("segment", "expected"),
    [
        ((2.0, 0.0, 3.0, 0.0), 2.0),
        ((3.0, 0.0, 2.0, 0.0), 2.0),
        ((-1.0, 0.0, 1.0, 0.0), 0.0),
        ((-3.0, 0.0, -2.0, 0.0), math.inf),
        ((2.0, 1.0, 3.0, 1.0), math.inf),
    ],
)
def test_a_segment_along_the_ray_counts_with_its_nearer_end(segment: tuple[float, ...], expected: float) -> None:
    assert ray_segments(ORIGIN, np.zeros(1), np.array([segment]))[0] == expected


def test_discs_agree_with_marching_along_the_ray() -> None:
    rng = np.random.default_rng(3)
    discs = np.column_stack([rng.uniform(-2, 2, (8, 2)), rng.uniform(0.05, 0.4, 8)])
    angles = rng.uniform(-math.pi, math.pi, 150)
    origin = np.array([0.1, -0.2])
    pitch = 1e-3
    along = np.arange(0, 4, pitch)
    points = origin + along[None, :, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None, :]
    inside = (np.linalg.norm(points[:, :, None, :] - discs[:, :2], axis=3) <= discs[:, 2]).any(axis=2)
    marched = np.where(inside.any(axis=1), along[inside.argmax(axis=1)], np.inf)
    cast = ray_discs(origin, angles, discs)
    assert np.isfinite(marched).sum() > 30
    assert np.isinf(marched).sum() > 30
    grazing = np.isinf(marched) & np.isfinite(cast)  # chords shorter than the pitch escape the marching
    assert grazing.sum() <= 1
    both = np.isfinite(marched)
    assert np.all((marched[both] - cast[both] >= -1e-12) & (marched[both] - cast[both] <= pitch))


@pytest.mark.parametrize(
    ("disc", "expected"),
    [
        ((3.0, 0.0, 1.0), 2.0),
        ((3.0, 1.0, 1.0), 3.0),
        ((-3.0, 0.0, 1.0), math.inf),
        ((3.0, 1.5, 1.0), math.inf),
        ((0.2, 0.0, 0.5), 0.0),
    ],
)
def test_a_disc_ahead_abeam_behind_missed_and_around(disc: tuple[float, ...], expected: float) -> None:
    assert ray_discs(ORIGIN, np.zeros(1), np.array([disc]))[0] == expected


def test_an_empty_world_returns_nothing() -> None:
    assert np.all(np.isinf(ray_segments(ORIGIN, np.zeros(3), np.empty((0, 4)))))
    assert np.all(np.isinf(ray_discs(ORIGIN, np.zeros(3), np.empty((0, 3)))))
