"""Lines matched with the segments of a map: closed forms, both forms of one line, lengths, and what tells nothing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from dynpf import kernels
from dynpf.maps import SegmentMap
from dynpf.measurement import Lines, PolarLines, PolarLinesParams
from dynpf.reference import lines as reference_lines
from dynpf.rng import Stream

# A room of 4 m by 3 m with a wall of 1 m within it.
ROOM = SegmentMap([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [2, 0, 2, 1]])
SIGMAS = {"sigma_rho": 0.1, "sigma_alpha": 0.05}
HALVES = np.full(2, 0.5, dtype=np.float32)
PARTICLES = np.array([[1.0, 1.1], [2.0, 2.0], [0.5, 0.6]], dtype=np.float32)


def model(
    segments: SegmentMap = ROOM, outlier_fraction: float = 0.0, tolerance: float = 0.2, along: float | None = None
) -> PolarLines:
    params = PolarLinesParams(
        outlier_fraction=outlier_fraction, length_tolerance=tolerance, sigma_along=along, **SIGMAS
    )
    return PolarLines(params, segments)


def lines(*rows: tuple[float, float, float]) -> Lines:
    return Lines(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)


def peak(count: int = 1) -> float:
    return -count * math.log(2.0 * math.pi * 0.1 * 0.05)


def test_the_log_likelihood_is_the_sum_over_lines_of_the_gaussian_about_the_matched_wall() -> None:
    # From (1, 2, 0.5) the upper wall lies 1 m off at pi/2 - 0.5, the left one 1 m off at pi - 0.5.
    batch = lines((1.05, math.pi / 2 - 0.47, 3.0), (0.9, math.pi - 0.5, 2.0))
    expected = norm.logpdf(0.05, scale=0.1) + norm.logpdf(0.03, scale=0.05)
    expected += norm.logpdf(-0.1, scale=0.1) + norm.logpdf(0.0, scale=0.05)
    likelihood = model().log_likelihood(PARTICLES, batch)
    assert likelihood.dtype == np.float32
    assert likelihood[0] == pytest.approx(expected, abs=1e-4)
    assert likelihood[1] < likelihood[0]


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2])
def test_a_line_and_its_other_form_are_as_likely(turns: int) -> None:
    batch = lines((0.97, math.pi / 2 - 0.45, 3.0))
    other = lines(((-1) ** turns * 0.97, math.pi / 2 - 0.45 + turns * math.pi, 3.0))
    expected = model().log_likelihood(PARTICLES, batch)
    assert model().log_likelihood(PARTICLES, other) == pytest.approx(expected, abs=2e-3)


def test_a_wall_underfoot_is_matched_from_either_side_of_it() -> None:
    # The robot stands 1 cm above the lower wall, or 1 cm below: the line is seen 1 cm off on the one side or the other.
    above = lines((0.01, -math.pi / 2, 3.0))
    particles = np.array([[1.0, 1.0], [0.01, -0.01], [0.0, 0.0]])
    expected = [peak(), peak() - 0.5 * (0.02 / 0.1) ** 2]
    assert model().log_likelihood(particles, above) == pytest.approx(expected, abs=1e-4)


def test_a_wall_behind_is_not_one_in_front() -> None:
    # Only the right wall of the room is left: 3 m in front, where 3 m behind would be the same rho.
    right = SegmentMap([[4, 0, 4, 3]])
    particles = np.array([[1.0, 1.0], [1.0, 1.0], [0.0, math.pi]])
    ahead, behind = model(right).log_likelihood(particles, lines((3.0, 0.0, 2.0)))
    assert ahead == pytest.approx(peak(), abs=1e-4)
    assert behind < -1000.0


def test_a_line_is_not_taken_for_a_shorter_wall() -> None:
    # From (1.5, 0.5, 0) the inner wall, 1 m long, is 0.5 m ahead; of the others the right one is 2.5 m ahead.
    pose = np.array([[1.5], [0.5], [0.0]])
    for length, expected in ((1.15, peak()), (1.25, peak() - 0.5 * (2.0 / 0.1) ** 2)):
        assert model().log_likelihood(pose, lines((0.5, 0.0, length)))[0] == pytest.approx(expected, abs=1e-3)
    assert model(tolerance=0.3).log_likelihood(pose, lines((0.5, 0.0, 1.25)))[0] == pytest.approx(peak(), abs=1e-3)


def test_a_line_longer_than_every_wall_is_not_admitted_and_rules_all_out_without_outliers() -> None:
    long, good = (1.0, math.pi / 2 - 0.5, 4.3), (1.0, math.pi - 0.5, 2.0)
    assert model().admit(PARTICLES, HALVES, lines(long)) is None
    admitted = model().admit(PARTICLES, HALVES, lines(long, good))
    assert admitted is not None
    assert [np.asarray(values).tolist() for values in admitted[:3]] == [[value] for value in good]
    assert np.isneginf(model().log_likelihood(PARTICLES, lines(long, good))).all()
    floor = math.log(0.05 / (2.0 * math.pi * 4.0))
    assert model(outlier_fraction=0.05).log_likelihood(PARTICLES, lines(long)) == pytest.approx(floor)


def test_outliers_bound_how_much_one_line_can_say() -> None:
    floor = math.log(0.05 / (2.0 * math.pi * 4.0))
    far_off = np.array([[50.0, 1e30], [40.0, 0.0], [0.3, 0.0]])
    likelihood = model(outlier_fraction=0.05).log_likelihood(far_off, lines((1.0, 1.0, 2.0)))
    assert likelihood == pytest.approx(floor)
    assert (model().log_likelihood(far_off, lines((1.0, 1.0, 2.0))) < -1e4).all()


def test_the_likelihood_of_one_wall_integrates_to_one() -> None:
    alone = SegmentMap([[4, 0, 4, 3]])
    total = 0.0
    for rho in np.arange(2.0, 4.0, 0.05):
        for alpha in np.arange(-0.5, 0.5, 0.025):
            total += math.exp(model(alone).log_likelihood(np.array([[1.0], [1.0], [0.0]]), lines((rho, alpha, 1.0)))[0])
    assert total * 0.05 * 0.025 == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    "useless", [(np.nan, 0.0, 1.0), (1.0, np.nan, 1.0), (1.0, 0.0, np.nan), (np.inf, 0.0, 1.0), (1.0, -np.inf, 1.0)]
)
def test_a_line_that_tells_nothing_favours_no_particle(useless: tuple[float, float, float]) -> None:
    good = (1.0, math.pi - 0.5, 2.0)
    assert model().admit(PARTICLES, HALVES, lines(useless)) is None
    assert model().log_likelihood(PARTICLES, lines(useless)).tolist() == [0.0, 0.0]
    admitted = model().admit(PARTICLES, HALVES, lines(useless, good))
    assert admitted is not None
    assert [np.asarray(values).tolist() for values in admitted[:3]] == [[value] for value in good]
    alone = model().log_likelihood(PARTICLES, lines(good))
    assert model().log_likelihood(PARTICLES, lines(useless, good)).tolist() == alone.tolist()


def test_no_lines_tell_nothing() -> None:
    assert model().admit(PARTICLES, HALVES, lines()) is None
    assert model().log_likelihood(PARTICLES, lines()).tolist() == [0.0, 0.0]


def test_a_reading_without_doubt_is_admitted_as_it_is() -> None:
    good = lines((1.0, math.pi - 0.5, 2.0))
    assert model().admit(PARTICLES[:, :1], np.ones(1), good) is good


def test_a_pose_that_is_not_finite_is_impossible() -> None:
    particles = np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, np.nan]])
    assert np.isneginf(model(outlier_fraction=0.05).log_likelihood(particles, lines((1.0, 0.0, 1.0)))).all()


def test_batches_of_columns_have_the_bits_of_the_whole() -> None:
    particles = Stream.of(1, "test", 0).normals(3, 700)
    batch = lines((1.05, 1.0, 3.0), (0.9, -2.0, 0.5))
    for outlier_fraction in (0.0, 0.05):
        whole = model(outlier_fraction=outlier_fraction).log_likelihood(particles, batch)
        for split in (1, 100, 256, 555):
            pieces = np.split(particles, [split], axis=1)
            halves = [model(outlier_fraction=outlier_fraction).log_likelihood(piece, batch) for piece in pieces]
            assert np.concatenate(halves).tobytes() == whole.tobytes()
    assert len(kernels.lines.log_likelihood.signatures) == 1


def test_parameters_out_of_range_and_uneven_arrays_are_refused() -> None:
    with pytest.raises(ValueError, match="length_tolerance"):
        model(tolerance=-0.1)
    with pytest.raises(ValueError, match="inhomogeneous"):
        model().log_likelihood(PARTICLES, Lines(np.ones(2), np.ones(1), np.ones(2)))


def test_a_line_has_to_lie_where_the_wall_is_if_its_middle_is_known() -> None:
    # From (1, 2, 0) the upper wall, x from 0 to 4, is 1 m to the left. A metre of it, 2.5 m ahead, is within it; one
    # that reaches 0.5 m beyond its end is so by 0.4 m, for of the tolerance of 0.2 m one half is at each end.
    pose = np.array([[1.0], [2.0], [0.0]])
    for ahead, off in ((2.5, 0.0), (3.0, 0.4), (-1.0, 0.4)):
        seen = Lines(np.array([1.0]), np.array([math.pi / 2]), np.array([1.0]), np.array([-ahead]))
        got = model(along=0.1).log_likelihood(pose, seen)[0]
        assert got == pytest.approx(peak() - 0.5 * (off / 0.1) ** 2, abs=2e-3)
        assert model().log_likelihood(pose, seen)[0] == pytest.approx(peak(), abs=1e-4)
        assert model(along=0.1).log_likelihood(pose, seen._replace(middles=None))[0] == pytest.approx(peak(), abs=1e-4)


@settings(max_examples=150, deadline=None)
@given(
    poses=st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-7, 7)), min_size=1, max_size=4),
    batch=st.lists(st.tuples(st.floats(-1, 6), st.floats(-4, 4), st.floats(0.1, 5.0)), min_size=1, max_size=4),
    outlier_fraction=st.sampled_from([0.0, 0.01, 0.5]),
    segments=st.lists(st.tuples(*[st.integers(-9, 9)] * 4).filter(lambda s: s[:2] != s[2:]), min_size=1, max_size=5),
    along=st.sampled_from([None, 0.2]),
    middle=st.floats(-4.0, 4.0),
)
def test_the_kernel_is_the_reference(
    poses: list[tuple[float, float, float]],
    batch: list[tuple[float, float, float]],
    outlier_fraction: float,
    segments: list[tuple[int, int, int, int]],
    along: float | None,
    middle: float,
) -> None:
    """Errors are right to 5e-6 m and rad, 1e-4 sigma: half a squared deviation d^2 is right to 1e-4 (1 + d^2).

    At a right angle a line has two forms that need the same turn, of which rounding takes one: with either the turn
    alone makes it impossible, but rho decides how impossible. So nothing below -400 is compared.
    """
    particles = np.array(poses, dtype=np.float32).T
    reading = lines(*batch)._replace(middles=np.linspace(middle, -middle, len(batch)))
    x, y, theta = particles.astype(np.float64)
    expected = reference_lines.log_likelihood(
        x,
        y,
        theta,
        rhos=reading.rho,
        alphas=reading.alpha,
        lengths=reading.lengths,
        segments=np.array(segments, dtype=np.float64),
        **SIGMAS,
        length_tolerance=0.2,
        outlier_fraction=outlier_fraction,
        outlier_rho=4.0,
        middles=reading.middles,
        sigma_along=along or 0.0,
    )
    got = model(SegmentMap(segments), outlier_fraction, along=along).log_likelihood(particles, reading)
    likely = (expected > -400.0) | (got > -400.0)
    np.testing.assert_allclose(got[likely], expected[likely], rtol=2e-4, atol=1e-4 * len(batch))
    assert np.array_equal(np.isneginf(got), np.isneginf(expected))
