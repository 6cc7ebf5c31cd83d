"""Range and bearing to known landmarks: the source document's figures, closed forms, gate, and what tells nothing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from dynpf import kernels
from dynpf.maps import LandmarkMap
from dynpf.measurement import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.measurement.range_bearing import SensorRows, SightingNoise
from dynpf.reference import landmarks as reference_landmarks
from dynpf.rng import Stream
from dynpf.se2 import wrap_angle

# Three landmarks of the run that LANDMARK uses.
LANDMARKS = LandmarkMap([(6, 1.88032539, -5.57229508), (13, 3.07964257, 0.24942861), (17, -1.04151642, 2.80020985)])
NOISE = {"sigma_range": 0.3, "sigma_range_per_m": 0.1, "sigma_bearing": 0.05}
PLAIN = RangeBearingParams(tempering=1.0, outlier_fraction=0.0, **NOISE)
PARTICLES = np.array([[0.0, 0.1], [3.0, 2.9], [0.0, -0.1]], dtype=np.float32)
HALVES = np.full(2, 0.5, dtype=np.float32)


def model(params: RangeBearingParams = PLAIN) -> RangeBearing:
    return RangeBearing(params, LANDMARKS)


def readings(*rows: tuple[int, float, float]) -> RangeBearingReadings:
    landmarks, ranges, bearings = zip(*rows, strict=True) if rows else ((), (), ())
    return RangeBearingReadings(np.array(landmarks, dtype=np.int64), np.array(ranges), np.array(bearings))


def cloud(count: int, spread: float = 1.0, seed: int = 1) -> np.ndarray:
    noise = Stream.of(seed, "test", 0).normals(3, count)
    return np.array([[0.0], [3.0], [0.0]], dtype=np.float32) + np.float32(spread) * noise


@pytest.mark.parametrize(
    ("pose", "landmark", "distance", "bearing"),
    [
        ((2.0, 3.0, 0.0), 6, 8.573130, -1.584756),
        ((0.0, 3.0, 0.0), 13, 4.129145, -0.729016),
        ((1.0, -2.0, 0.0), 17, 5.216302, 1.972919),
    ],
)
def test_expected_readings_are_those_of_the_source_document(
    pose: tuple[float, float, float], landmark: int, distance: float, bearing: float
) -> None:
    innovation = model().innovation(np.array(pose)[:, None], readings((landmark, distance, bearing)))
    assert innovation[:, 0] == pytest.approx([0.0, 0.0], abs=5e-7)


def test_the_log_likelihood_of_a_batch_is_the_sum_of_gaussian_log_densities() -> None:
    batch = readings((13, 4.3, -0.7), (6, 8.0, -1.4))
    expected = np.zeros(2)
    for landmark, distance, bearing in zip(*batch[:3], strict=True):
        east, north = LANDMARKS.position(int(landmark))
        mean_range = np.hypot(east - PARTICLES[0], north - PARTICLES[1])
        mean_bearing = np.arctan2(north - PARTICLES[1], east - PARTICLES[0]) - PARTICLES[2]
        covariance = np.diag([0.3**2 + (0.1 * distance) ** 2, 0.05**2])
        for i in range(2):
            expected[i] += multivariate_normal.logpdf([distance, bearing], [mean_range[i], mean_bearing[i]], covariance)
    likelihood = model().log_likelihood(PARTICLES, batch)
    assert likelihood.dtype == np.float32
    assert likelihood == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("outlier_fraction", [0.0, 0.3])
def test_the_likelihood_integrates_to_one(outlier_fraction: float) -> None:
    params = RangeBearingParams(
        tempering=1.0, sigma_range=0.3, sigma_range_per_m=0.0, sigma_bearing=0.2, outlier_fraction=outlier_fraction
    )
    ranges = (np.arange(100) + 0.5) * 0.1
    bearings = (np.arange(63) + 0.5) * (2.0 * math.pi / 63) - math.pi
    total = 0.0

    for bearing in bearings:
        for distance in ranges:
            total += math.exp(model(params).log_likelihood(PARTICLES[:, :1], readings((13, distance, bearing)))[0])
    assert total * 0.1 * (2.0 * math.pi / 63) == pytest.approx(1.0, abs=1e-4)


def test_tempering_scales_the_logarithm() -> None:
    batch = readings((13, 4.3, -0.7), (6, 8.0, -1.4))
    tempered = RangeBearingParams(tempering=0.4, outlier_fraction=0.0, **NOISE)
    whole = model().log_likelihood(PARTICLES, batch)
    assert model(tempered).log_likelihood(PARTICLES, batch) == pytest.approx(0.4 * whole, rel=1e-6)


def test_bearings_are_compared_the_short_way_round() -> None:
    facing_away = np.array([[4.07964257], [0.24942861], [0.0]])  # landmark 13 is exactly behind
    straight = model().log_likelihood(facing_away, readings((13, 1.0, math.pi)))
    for bearing in (math.pi - 0.01, -math.pi + 0.01, 5.0 * math.pi + 0.01):
        reading = readings((13, 1.0, bearing))
        assert abs(model().innovation(facing_away, reading)[1, 0]) == pytest.approx(0.01)
        loss = straight - model().log_likelihood(facing_away, reading)
        assert loss[0] == pytest.approx(0.5 * (0.01 / 0.05) ** 2, abs=1e-5)


def test_outliers_bound_how_much_one_reading_can_say() -> None:
    params = RangeBearingParams(tempering=1.0, outlier_fraction=0.01, outlier_range=10.0)
    particles = np.array([[0.0, 50.0, 1e30], [3.0, 50.0, 0.0], [0.0, 0.0, 0.0]])
    near, far, farthest = model(params).log_likelihood(particles, readings((13, 4.129145, -0.729016)))
    floor = math.log(0.01 / (10.0 * 2.0 * math.pi))
    assert [far, farthest] == pytest.approx([floor, floor], rel=1e-6)
    assert near > far + 5.0
    # Thirty at once: their product, 1e-114, is far below the smallest number that float32 holds.
    thirty = readings(*[(13, 4.129145, -0.729016)] * 30)
    assert model(params).log_likelihood(particles, thirty)[1] == pytest.approx(30.0 * floor, rel=1e-6)


@pytest.mark.parametrize("outlier_fraction", [0.0, 0.01])
def test_a_pose_that_is_not_finite_is_impossible(outlier_fraction: float) -> None:
    particles = np.zeros((3, 7), dtype=np.float32)
    for row in range(3):
        particles[row, 2 * row] = np.nan
        particles[row, 2 * row + 1] = np.inf
    params = RangeBearingParams(outlier_fraction=outlier_fraction)
    likelihood = model(params).log_likelihood(particles, readings((13, 4.0, 0.0)))
    assert np.isneginf(likelihood[:6]).all()
    assert np.isfinite(likelihood[6])


def test_the_gate_refuses_what_sure_particles_do_not_expect_and_unsure_ones_accept() -> None:
    weights = np.full(1000, 1e-3, dtype=np.float32)
    sure, unsure = cloud(1000, 0.01), cloud(1000, 0.7)
    right, misread, off = (13, 4.1, -0.73), (17, 4.1, -0.73), (13, 5.5, -1.0)
    admitted = model().admit(sure, weights, readings(misread, right, off))
    assert admitted is not None
    assert [values.tolist() for values in admitted[:3]] == [[13], [4.1], [-0.73]]
    assert model().admit(sure, weights, readings(misread)) is None
    assert model().admit(unsure, weights, readings(off)) is not None
    ungated = model(RangeBearingParams(gate=None))
    all_three = readings(misread, right, off)
    assert ungated.admit(sure, weights, all_three) is all_three


def test_the_gate_s_distance_is_that_of_the_weighted_innovations() -> None:
    particles, weights = cloud(700, 0.1), Stream.of(2, "test", 0).uniforms(1, 700)[0]
    weights /= weights.sum()
    reading = readings((13, 4.6, -0.8))
    errors = model().innovation(particles.astype(np.float64), reading)
    mean = np.average(errors, axis=1, weights=weights)
    covariance = np.cov(errors, aweights=weights, ddof=0) + model().noise(reading)
    distance = float(mean @ np.linalg.inv(covariance) @ mean)
    for gate, admitted in ((distance * 1.001, True), (distance * 0.999, False)):
        gated = model(RangeBearingParams(gate=gate, **NOISE))
        assert (gated.admit(particles, weights, reading) is not None) is admitted


@pytest.mark.parametrize(
    "useless", [(13, math.nan, 0.0), (13, 1.0, math.nan), (13, math.inf, 0.0), (13, 1.0, -math.inf), (99, 1.0, 0.0)]
)
@pytest.mark.parametrize("gate", [25.0, None])
def test_a_reading_that_tells_nothing_favours_no_particle(
    useless: tuple[int, float, float], gate: float | None
) -> None:
    gated = model(RangeBearingParams(gate=gate))
    assert gated.admit(PARTICLES, HALVES, readings(useless)) is None
    assert gated.log_likelihood(PARTICLES, readings(useless)).tolist() == [0.0, 0.0]
    good = (13, 4.1, -0.73)
    admitted = gated.admit(PARTICLES, HALVES, readings(useless, good))
    assert admitted is not None
    assert [values.tolist() for values in admitted[:3]] == [[13], [4.1], [-0.73]]
    both = gated.log_likelihood(PARTICLES, readings(useless, good))
    assert both.tolist() == gated.log_likelihood(PARTICLES, readings(good)).tolist()


def test_no_readings_and_no_landmarks_tell_nothing() -> None:
    assert model().admit(PARTICLES, HALVES, readings()) is None
    assert model().log_likelihood(PARTICLES, readings()).tolist() == [0.0, 0.0]
    empty = RangeBearing(PLAIN, LandmarkMap([]))
    assert empty.admit(PARTICLES, HALVES, readings((13, 4.1, -0.73))) is None
    assert empty.log_likelihood(PARTICLES, readings((13, 4.1, -0.73))).tolist() == [0.0, 0.0]


def test_one_particle_is_judged_by_the_reading_s_noise_alone() -> None:
    assert model().admit(PARTICLES[:, :1], np.ones(1, dtype=np.float32), readings((13, 4.1, -0.73))) is not None
    assert model().admit(PARTICLES[:, :1], np.ones(1, dtype=np.float32), readings((13, 4.1, 0.73))) is None


def test_arrays_of_different_lengths_are_refused() -> None:
    for landmarks, ranges in ((2, 1), (1, 2)):
        uneven = RangeBearingReadings(np.full(landmarks, 13), np.ones(ranges), np.ones(1))
        with pytest.raises(ValueError, match="ranges and 1 bearings: a reading needs one of each"):
            model().log_likelihood(PARTICLES, uneven)
    with pytest.raises(ValueError, match="for 2 particles"):
        model().admit(PARTICLES, HALVES[:1], readings((13, 4.1, -0.73)))


def test_the_kernels_are_compiled_once_whatever_the_arrays_are() -> None:
    batch = readings((13, 4.3, -0.7))
    frozen = np.frombuffer(np.array([4.3], dtype=np.float32).tobytes(), dtype=np.float32)
    kinds = (
        batch,
        RangeBearingReadings(batch.landmarks.astype(np.int32), frozen, batch.bearings.astype(np.float32)),
        RangeBearingReadings(*(np.repeat(values, 2)[::2] for values in batch[:3])),
        readings(),
    )
    for particles in (PARTICLES, PARTICLES.astype(np.float64), np.asfortranarray(PARTICLES), cloud(9)[:, 2:4]):
        for kind in kinds:
            for landmarks in (LANDMARKS, LandmarkMap([])):
                RangeBearing(PLAIN, landmarks).log_likelihood(particles, kind)
                RangeBearing(PLAIN, landmarks).admit(particles, np.ones(particles.shape[1]), kind)
    assert len(kernels.landmarks.log_likelihood.signatures) == 1
    assert len(kernels.landmarks.distances.signatures) == 1


@pytest.mark.parametrize("count", [1, 300, 1000])
def test_batches_of_columns_have_the_bits_of_the_whole(count: int) -> None:
    particles = cloud(count)
    batch = readings((13, 4.3, -0.7), (6, 8.0, -1.4))
    for params in (PLAIN, RangeBearingParams()):
        whole = model(params).log_likelihood(particles, batch)
        for split in (0, count // 3, count // 2):
            pieces = [model(params).log_likelihood(part, batch) for part in np.split(particles, [split], axis=1)]
            assert np.concatenate(pieces).tobytes() == whole.tobytes()


def test_the_jacobian_is_that_of_finite_differences() -> None:
    states = np.vstack((cloud(20, 0.5).astype(np.float64), np.ones((2, 20))))
    batch = readings((13, 4.3, -0.7), (6, 8.0, -1.4))
    jacobian = model().jacobian(states, batch)
    assert jacobian.shape == (4, 5, 20)
    for row in range(5):
        step = np.zeros((5, 1))
        step[row] = 1e-6
        ahead, behind = model().innovation(states + step, batch), model().innovation(states - step, batch)
        assert jacobian[:, row] == pytest.approx(-wrap_angle(ahead - behind) / 2e-6, abs=1e-7)


def test_the_jacobian_at_a_landmark_is_finite() -> None:
    states = np.array([[3.07964257], [0.24942861], [0.0]])
    assert model().jacobian(states, readings((13, 0.1, 0.0)))[:, :, 0].tolist() == [[0, 0, 0], [0, 0, -1]]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gaussian_methods_keep_the_states_precision(dtype: type) -> None:
    batch = readings((13, 4.3, -0.7))
    assert model().innovation(PARTICLES.astype(dtype), batch).dtype == dtype
    assert model().jacobian(PARTICLES.astype(dtype), batch).dtype == dtype


def test_the_gaussian_of_the_noise_is_the_tempered_likelihood_up_to_a_constant() -> None:
    tempered = model(RangeBearingParams(tempering=0.35, outlier_fraction=0.0, **NOISE))
    batch = readings((13, 4.3, -0.7), (6, 8.0, -1.4))
    errors = tempered.innovation(PARTICLES.astype(np.float64), batch)
    squared = np.einsum("in,ij,jn->n", errors, np.linalg.inv(tempered.noise(batch)), errors)
    likelihood = tempered.log_likelihood(PARTICLES, batch)
    assert likelihood[0] - likelihood[1] == pytest.approx(-0.5 * (squared[0] - squared[1]), rel=1e-4)


def test_a_landmark_outside_the_map_has_no_innovation() -> None:
    with pytest.raises(KeyError):
        model().innovation(PARTICLES, readings((99, 1.0, 0.0)))


def test_poses_stand_on_the_ring_from_which_the_first_reading_is_seen() -> None:
    reading = readings((99, 1.0, 0.0), (13, 2.0, 0.5), (6, 8.0, -1.4))
    drawn = model().poses(reading, 4000, Stream.of(1, "test", 3))
    assert drawn.dtype == np.float32
    errors = model().innovation(drawn.astype(np.float64), readings((13, 2.0, 0.5)))
    sigma = np.array([math.hypot(0.3, 0.2), 0.05])
    assert errors.mean(axis=1) / sigma == pytest.approx([0.0, 0.0], abs=4.0 / math.sqrt(4000))
    assert errors.std(axis=1) / sigma == pytest.approx([1.0, 1.0], abs=0.05)
    east, north = LANDMARKS.position(13)
    around = np.arctan2(drawn[1] - north, drawn[0] - east)
    quarters = np.histogram(around, bins=4, range=(-math.pi, math.pi))[0]
    assert quarters == pytest.approx(1000, abs=4.0 * math.sqrt(1000))
    first, second = model().poses(reading, 10, Stream.of(1, "test", 3)), drawn[:, :10]
    assert first.tobytes() == second.tobytes()
    with pytest.raises(ValueError, match="none of the 1 readings"):
        model().poses(readings((99, 1.0, 0.0)), 5, Stream.of(1, "test", 3))


def test_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"RangeBearingParams.tempering = 1.5"):
        model(RangeBearingParams(tempering=1.5))


POSES = st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-7, 7)), min_size=1, max_size=4)
BATCHES = st.lists(st.tuples(st.integers(1, 4), st.floats(0, 12), st.floats(-4, 4)), max_size=4)


@settings(max_examples=150, deadline=None)
@given(
    poses=POSES,
    batch=BATCHES,
    sigmas=st.tuples(st.floats(0.05, 1.0), st.floats(0.0, 0.3), st.floats(0.05, 1.0)),
    outlier_fraction=st.sampled_from([0.0, 0.01, 0.5]),
    tempering=st.sampled_from([1.0, 0.35]),
)
def test_the_kernels_are_the_references(
    poses: list[tuple[float, float, float]],
    batch: list[tuple[int, float, float]],
    sigmas: tuple[float, float, float],
    outlier_fraction: float,
    tempering: float,
) -> None:
    """With coordinates below 16 errors are right to 4e-6 m and rad, so 1e-4 sigma: d^2/2 then is to 1e-4 (1 + d^2)."""
    some = LandmarkMap([(1, 5.0, 5.0), (2, -4.0, 3.0), (3, 0.5, -6.0)])
    params = RangeBearingParams(
        sigma_range=sigmas[0],
        sigma_range_per_m=sigmas[1],
        sigma_bearing=sigmas[2],
        outlier_fraction=outlier_fraction,
        tempering=tempering,
    )
    noise = {"sigma_range": sigmas[0], "sigma_range_per_m": sigmas[1], "sigma_bearing": sigmas[2]}
    reading = readings(*batch)
    particles = np.array(poses, dtype=np.float32).T
    x, y, theta = particles
    expected = reference_landmarks.log_likelihood(
        x,
        y,
        theta,
        landmarks=reading.landmarks,
        ranges=reading.ranges,
        bearings=reading.bearings,
        ids=np.array(some.ids),
        easts=some.positions[0],
        norths=some.positions[1],
        **noise,
        outlier_fraction=outlier_fraction,
        outlier_range=10.0,
        tempering=tempering,
    )
    got = RangeBearing(params, some).log_likelihood(particles, reading)
    np.testing.assert_allclose(got, expected, rtol=2e-4, atol=1e-4 * (1 + len(batch)))


@settings(max_examples=100, deadline=None)
@given(poses=POSES, reading=st.tuples(st.integers(1, 4), st.floats(0, 12), st.floats(-0.1, 0.1)))
def test_the_gate_s_kernel_is_the_reference(
    poses: list[tuple[float, float, float]], reading: tuple[int, float, float]
) -> None:
    """Headings within 0.1 of where the landmark is: at the seam of bearings one float decides between pi and -pi."""
    some = LandmarkMap([(1, 5.0, 5.0), (2, -4.0, 3.0), (3, 0.5, 20.0)])
    particles = np.array(poses, dtype=np.float32).T.copy()
    if reading[0] in some:
        east, north = some.position(reading[0])
        particles[2] = np.arctan2(north - particles[1], east - particles[0]) + particles[2] / 70.0
    weights = np.arange(1, len(poses) + 1, dtype=np.float32)
    landmark, distance, bearing = readings(reading)[:3]
    ids, positions = np.array(some.ids), some.positions.astype(np.float32)
    seen = landmark, distance.astype(np.float32), bearing.astype(np.float32)
    noise = np.array(SightingNoise(0.3, 0.1, 0.2, outlier_fraction=0.0, outlier_range=1.0, tempering=1.0))
    out = np.empty(1)
    kernels.landmarks.distances(particles, weights, *seen, ids, positions, noise, out)
    x, y, theta = particles
    expected = reference_landmarks.distances(
        x,
        y,
        theta,
        weights,
        landmarks=landmark,
        ranges=distance,
        bearings=bearing,
        ids=ids,
        easts=positions[0],
        norths=positions[1],
        sigma_range=0.3,
        sigma_range_per_m=0.1,
        sigma_bearing=0.2,
    )
    np.testing.assert_allclose(out, expected, rtol=2e-4, atol=1e-4)


ROWS = SensorRows(bearing_bias=3, range_scale=4)


def test_a_calibrated_state_reads_as_an_uncalibrated_one_whose_readings_are_corrected() -> None:
    # Noise of the range that does not grow with it, which is then the same before and after a correction.
    params = RangeBearingParams(sigma_range_per_m=0.0, outlier_fraction=0.0, gate=None, tempering=1.0)
    batch = readings((13, 4.3, -0.7), (6, 8.0, -1.4), (99, 1.0, 0.0))
    states = np.concatenate([PARTICLES, [[0.05, 0.0], [1.1, 1.0]]]).astype(np.float32)
    calibrated = RangeBearing(params, LANDMARKS, ROWS)
    found = calibrated.log_likelihood(states, batch)
    plain = model(params)
    assert found[1] == pytest.approx(plain.log_likelihood(PARTICLES, batch)[1], rel=1e-5)
    errors = calibrated.innovation(states.astype(np.float64), readings((13, 4.3, -0.7), (6, 8.0, -1.4)))
    sigmas = np.tile([params.sigma_range, params.sigma_bearing], 2)[:, None]
    density = -0.5 * (errors / sigmas) ** 2 - np.log(np.sqrt(2.0 * np.pi) * sigmas)
    assert found == pytest.approx(density.sum(axis=0), rel=1e-4)
    assert errors[:, 0] != pytest.approx(plain.innovation(states, batch.only(batch.landmarks != 99))[:, 0], abs=0.01)


def test_the_jacobian_of_a_calibrated_state_is_the_derivative() -> None:
    calibrated = RangeBearing(PLAIN, LANDMARKS, ROWS)
    states = np.array([[0.3], [2.0], [0.4], [0.05], [1.1]])
    batch, step = readings((13, 4.3, -0.7), (6, 8.0, -1.4)), 1e-6
    found = calibrated.jacobian(states, batch)
    for row in range(5):
        shift = np.zeros((5, 1))
        shift[row] = step
        ahead, behind = (calibrated.innovation(states + sign * shift, batch) for sign in (1.0, -1.0))
        assert found[:, row] == pytest.approx((behind - ahead) / (2.0 * step), abs=1e-8)


def test_a_bias_that_all_particles_share_is_no_reason_to_refuse_a_reading() -> None:
    poses = cloud(1000, 0.01)
    biased = np.concatenate([poses, np.full((1, 1000), 0.3), np.ones((1, 1000))]).astype(np.float32)
    weights = np.full(1000, 1e-3, dtype=np.float32)
    shifted = readings((13, 4.1, -0.73 + 0.3))
    assert RangeBearing(RangeBearingParams(), LANDMARKS, ROWS).admit(biased, weights, shifted) is shifted
    assert model().admit(poses, weights, shifted) is None
    # Mere poses, such as candidates for a start, have no calibration.
    assert RangeBearing(RangeBearingParams(), LANDMARKS, ROWS).admit(poses, weights, readings((13, 4.1, -0.73)))


@pytest.mark.parametrize("rows", [None, ROWS])
def test_a_landmark_that_moves_is_where_the_reading_says(rows: SensorRows | None) -> None:
    still = readings((13, 4.3, -0.7), (6, 8.0, -1.4))
    places = np.array([[np.nan, LANDMARKS.position(6)[0]], [np.nan, LANDMARKS.position(6)[1]]])
    moving = RangeBearingReadings(np.array([13, 2]), still.ranges, still.bearings, places)
    states = PARTICLES if rows is None else np.concatenate([PARTICLES, np.zeros((1, 2)), np.ones((1, 2))])
    one = RangeBearing(RangeBearingParams(gate=None), LANDMARKS, rows)
    assert one.log_likelihood(states, moving) == pytest.approx(one.log_likelihood(states, still), rel=1e-6)
    assert np.array_equal(one.innovation(states, moving), one.innovation(states, still))
    assert np.array_equal(one.jacobian(states, moving), one.jacobian(states, still))
    assert one.admit(states, HALVES, moving) is moving
    stream = Stream.of(1, "test", 0)
    start = one.poses(moving.only(np.array([False, True])), 5, stream)
    assert np.array_equal(start, one.poses(still.only(np.array([False, True])), 5, stream))
    gone = one.admit(states, HALVES, RangeBearingReadings(np.array([2]), *still.only(np.array([False, True]))[1:3]))
    assert gone is None
