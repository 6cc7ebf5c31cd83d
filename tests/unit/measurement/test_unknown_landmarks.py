"""Range and bearing to landmarks that cannot be told apart: both associations, clutter, and what tells nothing."""

import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.maps import LandmarkMap
from dynpf.measurement import (
    RangeBearing,
    RangeBearingParams,
    RangeBearingReadings,
    UnknownLandmarks,
    UnknownLandmarksParams,
    UnlabelledReadings,
)
from dynpf.reference import landmarks as reference_landmarks
from dynpf.rng import Stream

Association = Literal["nearest", "mixture"]

LANDMARKS = LandmarkMap([(6, 5.0, 1.0), (13, 3.0, -4.0), (17, -1.0, 3.0)])
NOISE = {"sigma_range": 0.2, "sigma_range_per_m": 0.1, "sigma_bearing": 0.1}
PARTICLES = np.array([[0.0, 0.3], [0.0, -0.2], [0.0, 0.1]], dtype=np.float32)
HALVES = np.full(2, 0.5, dtype=np.float32)
BATCH = UnlabelledReadings(np.array([5.2, 4.9]), np.array([0.2, -0.95]))


def model(
    association: Association = "nearest", outlier_fraction: float = 0.0, tempering: float = 1.0
) -> UnknownLandmarks:
    params = UnknownLandmarksParams(
        association=association,
        outlier_fraction=outlier_fraction,
        tempering=tempering,
        **NOISE,
    )
    return UnknownLandmarks(params, LANDMARKS)


def known(landmark: int, reading: UnlabelledReadings) -> np.ndarray:
    params = RangeBearingParams(tempering=1.0, outlier_fraction=0.0, **NOISE)
    landmarks = np.full(len(reading.ranges), landmark)
    return RangeBearing(params, LANDMARKS).log_likelihood(PARTICLES, RangeBearingReadings(landmarks, *reading))


def single(index: int) -> UnlabelledReadings:
    return UnlabelledReadings(*(values[index : index + 1] for values in BATCH))


def test_each_reading_takes_the_likeliest_landmark_or_the_mean_of_all() -> None:
    each = [np.stack([known(landmark, single(index)) for landmark in LANDMARKS.ids]) for index in range(2)]
    nearest = sum(np.max(densities, axis=0) for densities in each)
    mixture = sum(np.log(np.mean(np.exp(densities), axis=0)) for densities in each)
    assert model("nearest").log_likelihood(PARTICLES, BATCH) == pytest.approx(nearest, rel=1e-5)
    assert model("mixture").log_likelihood(PARTICLES, BATCH) == pytest.approx(mixture, rel=1e-5)
    assert [int(np.argmax(densities[:, 0])) for densities in each] == [0, 1]


def test_with_one_landmark_both_are_the_known_correspondence() -> None:
    alone = LandmarkMap([(13, 3.0, -4.0)])
    for association in ("nearest", "mixture"):
        params = UnknownLandmarksParams(association=association, outlier_fraction=0.0, tempering=1.0, **NOISE)
        likelihood = UnknownLandmarks(params, alone).log_likelihood(PARTICLES, BATCH)
        assert likelihood == pytest.approx(known(13, BATCH), rel=1e-5)


@pytest.mark.parametrize("outlier_fraction", [0.0, 0.3])
def test_the_mixture_integrates_to_one(outlier_fraction: float) -> None:
    params = UnknownLandmarksParams(
        association="mixture",
        sigma_range=0.3,
        sigma_range_per_m=0.0,
        sigma_bearing=0.2,
        outlier_fraction=outlier_fraction,
        tempering=1.0,
    )
    bearings = (np.arange(63) + 0.5) * (2.0 * math.pi / 63) - math.pi
    total = 0.0
    for distance in (np.arange(100) + 0.5) * 0.1:
        for bearing in bearings:
            reading = UnlabelledReadings(np.array([distance]), np.array([bearing]))
            total += math.exp(UnknownLandmarks(params, LANDMARKS).log_likelihood(PARTICLES[:, :1], reading)[0])
    assert total * 0.1 * (2.0 * math.pi / 63) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("association", ["nearest", "mixture"])
def test_clutter_costs_a_particle_a_constant_with_outliers_and_everything_without(association: Association) -> None:
    clutter = UnlabelledReadings(np.array([5.2, 0.1]), np.array([0.2, 3.0]))
    near = model(association, 0.05).log_likelihood(PARTICLES, single(0))
    with_clutter = model(association, 0.05).log_likelihood(PARTICLES, clutter)
    assert with_clutter - near == pytest.approx(math.log(0.05 / (20.0 * math.pi)), abs=1e-4)
    assert (model(association).log_likelihood(PARTICLES, clutter) < -150.0).all()
    off_the_map = np.array([[1e30], [0.0], [0.0]])
    assert np.isfinite(model(association, 0.05).log_likelihood(off_the_map, clutter)).all()
    assert np.isneginf(model(association).log_likelihood(off_the_map, clutter)).all()


def test_identities_are_ignored_and_positions_are_enough() -> None:
    wrong = RangeBearingReadings(np.array([99, 17]), *BATCH)
    plain = model().log_likelihood(PARTICLES, BATCH).tolist()
    assert model().log_likelihood(PARTICLES, wrong).tolist() == plain
    assert model().admit(PARTICLES, HALVES, wrong) is wrong
    nameless = UnknownLandmarks(model().params, LANDMARKS.positions)
    assert nameless.log_likelihood(PARTICLES, BATCH).tolist() == plain


@pytest.mark.parametrize("association", ["nearest", "mixture"])
def test_readings_that_tell_nothing_favour_no_particle(association: Association) -> None:
    useless = UnlabelledReadings(np.array([np.nan, 1.0, np.inf]), np.array([0.0, np.nan, 0.0]))
    assert model(association).admit(PARTICLES, HALVES, useless) is None
    assert model(association).log_likelihood(PARTICLES, useless).tolist() == [0.0, 0.0]
    mixed = UnlabelledReadings(*(np.concatenate(pair) for pair in zip(useless, BATCH, strict=True)))
    admitted = model(association).admit(PARTICLES, HALVES, mixed)
    assert admitted is not None
    assert [values.tolist() for values in admitted] == [values.tolist() for values in BATCH]
    both = model(association).log_likelihood(PARTICLES, mixed)
    assert both.tolist() == model(association).log_likelihood(PARTICLES, BATCH).tolist()


def test_no_readings_and_no_landmarks_tell_nothing() -> None:
    none = UnlabelledReadings(np.empty(0), np.empty(0))
    assert model().admit(PARTICLES, HALVES, none) is None
    assert model().log_likelihood(PARTICLES, none).tolist() == [0.0, 0.0]
    empty = UnknownLandmarks(model().params, LandmarkMap([]))
    assert empty.admit(PARTICLES, HALVES, BATCH) is None
    assert empty.log_likelihood(PARTICLES, BATCH).tolist() == [0.0, 0.0]


def test_a_pose_that_is_not_finite_is_impossible() -> None:
    particles = np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, np.nan]])
    assert np.isneginf(model("mixture", 0.05).log_likelihood(particles, BATCH)).all()


@pytest.mark.parametrize("association", ["nearest", "mixture"])
def test_batches_of_columns_have_the_bits_of_the_whole(association: Association) -> None:
    particles = Stream.of(1, "test", 0).normals(3, 700)
    whole = model(association, 0.05).log_likelihood(particles, BATCH)
    for split in (1, 100, 256, 555):
        pieces = np.split(particles, [split], axis=1)
        halves = [model(association, 0.05).log_likelihood(piece, BATCH) for piece in pieces]
        assert np.concatenate(halves).tobytes() == whole.tobytes()
    assert len(kernels.landmarks.log_likelihood_unlabelled.signatures) == 1


def test_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="association"):
        model("best")  # type: ignore[arg-type]


@settings(max_examples=150, deadline=None)
@given(
    poses=st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-7, 7)), min_size=1, max_size=4),
    batch=st.lists(st.tuples(st.floats(0, 12), st.floats(-4, 4)), min_size=1, max_size=4),
    association=st.sampled_from(["nearest", "mixture"]),
    outlier_fraction=st.sampled_from([0.0, 0.01, 0.5]),
    tempering=st.sampled_from([1.0, 0.35]),
)
def test_the_kernel_is_the_reference(
    poses: list[tuple[float, float, float]],
    batch: list[tuple[float, float]],
    association: Association,
    outlier_fraction: float,
    tempering: float,
) -> None:
    """Errors are right to 4e-6 m and rad, less than 1e-4 sigma: half a squared deviation d^2 to 1e-4 (1 + d^2)."""
    particles = np.array(poses, dtype=np.float32).T
    reading = UnlabelledReadings(*np.array(batch).T)
    x, y, theta = particles
    expected = reference_landmarks.log_likelihood_unlabelled(
        x,
        y,
        theta,
        ranges=reading.ranges,
        bearings=reading.bearings,
        easts=LANDMARKS.positions[0],
        norths=LANDMARKS.positions[1],
        mixture=association == "mixture",
        **NOISE,
        outlier_fraction=outlier_fraction,
        outlier_range=10.0,
        tempering=tempering,
    )
    got = model(association, outlier_fraction, tempering).log_likelihood(particles, reading)
    np.testing.assert_allclose(got, expected, rtol=2e-4, atol=1e-4 * len(batch))
