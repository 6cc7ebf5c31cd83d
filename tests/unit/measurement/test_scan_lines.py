"""Split and merge on rooms whose lines are known, and lines weighed where walls hide them."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.maps import SegmentMap
from dynpf.measurement import Lines, PolarLinesParams, Scan, ScanLines, ScanLinesParams
from dynpf.measurement.ray import ray_segments
from dynpf.measurement.split_and_merge import SplitAndMergeParams, extract_lines, fit_line

# A room of 4 m by 3 m, and a screen of 1 m before its right wall.
ROOM = SegmentMap([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [3, 1, 3, 2]])


def scan(x: float, y: float, theta: float, *, width: float = math.tau, beams: int = 361, noise: float = 0.0) -> Scan:
    angles = np.linspace(-width / 2, width / 2, beams, endpoint=width < 6.0)
    ranges = ray_segments(np.array([x, y]), theta + angles, ROOM.segments)
    ranges = ranges + noise * np.random.default_rng(1).standard_normal(beams)
    return Scan(angles.astype(np.float32), ranges.astype(np.float32), 0.1, 10.0)


def found(lines: Lines, rho: float, alpha: float) -> list[int]:
    """Return the lines near a polar form."""
    turned = np.remainder(np.asarray(lines.alpha) - alpha + np.pi, 2 * np.pi) - np.pi
    return np.flatnonzero((np.abs(np.asarray(lines.rho) - rho) < 0.02) & (np.abs(turned) < 0.02)).tolist()


@settings(max_examples=40, deadline=None)
@given(x=st.floats(0.5, 2.5), y=st.floats(0.5, 2.5), theta=st.floats(-3.0, 3.0))
def test_every_wall_of_a_room_is_found_where_it_is(x: float, y: float, theta: float) -> None:
    lines = extract_lines(scan(x, y, theta), SplitAndMergeParams())
    for rho, direction in ((x, np.pi), (y, -np.pi / 2), (3.0 - y, np.pi / 2), (3.0 - x, 0.0)):
        assert found(lines, rho, direction - theta), (rho, direction)


def test_a_line_is_as_long_as_what_was_seen_of_it_and_its_middle_is_there() -> None:
    # A view of 90 degrees on the left wall, 1 m off, from (1, 1): 2 m of it, from y = 0 to y = 2.
    lines = extract_lines(scan(1.0, 1.2, np.pi, width=np.pi / 2, beams=181), SplitAndMergeParams())
    assert lines.rho == pytest.approx([1.0], abs=1e-6)
    assert lines.lengths == pytest.approx([2.0], abs=1e-6)
    assert lines.middles == pytest.approx([0.0], abs=1e-6)
    # Looking 0.3 rad to the right of it, the middle of what is seen lies to the right.
    aside = extract_lines(scan(1.0, 1.2, np.pi - 0.3, width=0.5, beams=101), SplitAndMergeParams())
    ends = math.tan(-0.05), math.tan(-0.55)
    assert aside.alpha == pytest.approx([0.3], abs=1e-6)
    assert aside.middles == pytest.approx([sum(ends) / 2], abs=1e-5)


def test_a_wall_with_a_gap_in_it_is_two_lines_and_noise_splits_none() -> None:
    whole = scan(1.0, 1.5, 0.5 * np.pi, width=1.0, beams=161, noise=0.01)
    assert len(extract_lines(whole, SplitAndMergeParams()).rho) == 1
    ranges = whole.ranges.copy()
    ranges[55:105] = 10.0
    halves = extract_lines(whole._replace(ranges=ranges), SplitAndMergeParams())
    assert len(halves.rho) == 2
    assert halves.rho == pytest.approx([1.5, 1.5], abs=0.02)


def test_what_is_no_line_gives_none() -> None:
    angles = np.linspace(-1.0, 1.0, 101, dtype=np.float32)
    nothing = Scan(angles, np.full(101, 10.0, dtype=np.float32), 0.1, 10.0)
    for ranges in (nothing.ranges, np.full(101, np.nan, dtype=np.float32), np.zeros(101, dtype=np.float32)):
        lines = extract_lines(nothing._replace(ranges=ranges), SplitAndMergeParams())
        assert [np.asarray(row).shape for row in lines] == [(0,)] * 4
    around = extract_lines(nothing._replace(ranges=np.full(101, 1.0, dtype=np.float32)), SplitAndMergeParams())
    # Chords of a circle of radius 1 that stay within 0.08 m of it have half angles of acos(0.92); two may merge.
    assert max(np.asarray(around.lengths), default=0.0) < 4.0 * math.sin(math.acos(0.92))


@given(alpha=st.floats(-3.0, 3.0), rho=st.floats(0.5, 5.0), seed=st.integers(0, 99))
def test_the_fit_is_the_least_squares_line(alpha: float, rho: float, seed: int) -> None:
    # Oracle: the direction of least variance is the last singular vector of the centred points.
    rng = np.random.default_rng(seed)
    along = rng.uniform(-1.0, 1.0, 12)
    across = rho + 0.02 * rng.standard_normal(12)
    points = np.stack([across * np.cos(alpha) - along * np.sin(alpha), across * np.sin(alpha) + along * np.cos(alpha)])
    normal = np.linalg.svd(points - points.mean(axis=1, keepdims=True))[0][:, 1]
    got_rho, got_alpha = fit_line(points)
    assert abs(normal @ [np.cos(got_alpha), np.sin(got_alpha)]) == pytest.approx(1.0, abs=1e-9)
    assert got_rho == pytest.approx(points.mean(axis=1) @ [np.cos(got_alpha), np.sin(got_alpha)])


def model(**params: object) -> ScanLines:
    usual = ScanLinesParams(lines=PolarLinesParams(sigma_along=0.1, outlier_fraction=0.05))
    return ScanLines(msgspec.structs.replace(usual, **params), ROOM)


def test_a_line_that_a_wall_hides_is_an_outlier() -> None:
    # 1 m of the right wall, straight ahead, 1.5 m off: from x = 2.5 the screen at x = 3 hides it.
    seen = Lines(np.array([1.5]), np.array([0.0]), np.array([1.0]), np.array([0.0]))
    hidden = np.array([[2.5], [1.5], [0.0]], dtype=np.float32)
    assert model(hidden=None).log_likelihood(hidden, seen)[0] > 2.0
    assert model().log_likelihood(hidden, seen)[0] == model().polar.log_outlier
    free = np.array([[2.5], [2.4], [0.0]], dtype=np.float32)  # past the screen, which ends at y = 2
    assert model().log_likelihood(free, seen)[0] == model(hidden=None).log_likelihood(free, seen)[0] > 2.0


def test_the_true_pose_is_likelier_than_others_and_tempering_is_an_exponent() -> None:
    poses = np.array([[1.0, 1.6, 1.0], [1.2, 1.2, 1.2], [0.4, 0.4, 0.8]], dtype=np.float32)
    reading = model().admit(poses, np.full(3, 1 / 3, np.float32), scan(1.0, 1.2, 0.4, width=3.0))
    assert reading is not None
    assert model().count(reading) == len(reading.rho) >= 3
    likelihood = model().log_likelihood(poses, reading)
    assert np.argmax(likelihood) == 0
    np.testing.assert_allclose(model(tempering=0.25).log_likelihood(poses, reading), 0.25 * likelihood, rtol=1e-6)


def test_a_scan_without_lines_is_not_admitted_and_one_kernel_serves_all() -> None:
    poses = np.zeros((3, 2), dtype=np.float32)
    empty = Scan(np.zeros(0, np.float32), np.zeros(0, np.float32), 0.0, 4.0)
    assert model().admit(poses, np.full(2, 0.5, np.float32), empty) is None
    assert model().admit(poses, np.full(2, 0.5, np.float32), model().example()) is not None
    model().log_likelihood(poses, model().example())
    assert len(kernels.lines.log_likelihood.signatures) == 1


def test_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="tempering"):
        model(tempering=0.0)
