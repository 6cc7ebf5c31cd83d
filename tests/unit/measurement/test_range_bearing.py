"""Range and bearing to known landmarks: the source document's figures, closed forms, gate, and what tells nothing."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from dynpf.maps import LandmarkMap
from dynpf.measurement import RangeBearing, RangeBearingParams, RangeBearingReading

# Three landmarks of the run that LANDMARK uses.
LANDMARKS = LandmarkMap([(6, 1.88032539, -5.57229508), (13, 3.07964257, 0.24942861), (17, -1.04151642, 2.80020985)])
PLAIN = RangeBearingParams(
    tempering=1.0, outlier_fraction=0.0, sigma_range=0.3, sigma_range_per_m=0.1, sigma_bearing=0.05
)


def model(params: RangeBearingParams = PLAIN) -> RangeBearing:
    return RangeBearing(params, LANDMARKS)


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
    ranges, bearings = model().expected(np.array(pose)[:, None], landmark)
    assert ranges[0] == pytest.approx(distance, abs=5e-7)
    assert bearings[0] == pytest.approx(bearing, abs=5e-7)


def test_the_log_likelihood_is_the_gaussian_density() -> None:
    particles = np.array([[0.0, 0.1], [3.0, 2.9], [0.0, -0.1]])
    reading = RangeBearingReading(13, 4.3, -0.7)
    ranges, bearings = model().expected(particles, 13)
    sigma_range = math.hypot(0.3, 0.1 * 4.3)
    expected = [
        multivariate_normal.logpdf([4.3, -0.7], mean=[r, b], cov=np.diag([sigma_range**2, 0.05**2]))
        for r, b in zip(ranges, bearings, strict=True)
    ]
    assert model().log_likelihood(particles, reading) == pytest.approx(expected)


def test_tempering_scales_the_logarithm() -> None:
    particles = np.array([[0.0, 0.1], [3.0, 2.9], [0.0, -0.1]])
    reading = RangeBearingReading(13, 4.3, -0.7)
    tempered = RangeBearingParams(
        tempering=0.4, outlier_fraction=0.0, sigma_range=0.3, sigma_range_per_m=0.1, sigma_bearing=0.05
    )
    assert model(tempered).log_likelihood(particles, reading) == pytest.approx(
        0.4 * model().log_likelihood(particles, reading)
    )


def test_bearings_are_compared_the_short_way_round() -> None:
    facing_away = np.array([[4.07964257], [0.24942861], [0.0]])  # landmark 13 is exactly behind
    for bearing in (math.pi - 0.01, -math.pi + 0.01):
        innovation = model().innovation(facing_away, RangeBearingReading(13, 1.0, bearing))
        assert abs(innovation[1, 0]) == pytest.approx(0.01)


def test_outliers_bound_how_much_one_reading_can_say() -> None:
    params = RangeBearingParams(tempering=1.0, outlier_fraction=0.01, outlier_range=10.0)
    particles = np.array([[0.0, 50.0], [3.0, 50.0], [0.0, 0.0]])
    near, far = model(params).log_likelihood(particles, RangeBearingReading(13, 4.129145, -0.729016))
    assert far == pytest.approx(math.log(0.01 / (10.0 * 2.0 * math.pi)))
    assert near > far + 5.0


def test_the_gate_refuses_what_sure_particles_do_not_expect_and_unsure_ones_accept() -> None:
    weights = np.full(1000, 1e-3)
    noise = np.random.Generator(np.random.Philox(key=1)).standard_normal((3, 1000))
    sure = np.array([[0.0], [3.0], [0.0]]) + 0.01 * noise
    unsure = np.array([[0.0], [3.0], [0.0]]) + np.array([[1.0], [1.0], [0.5]]) * noise
    right = RangeBearingReading(13, 4.1, -0.73)
    misread = RangeBearingReading(17, 4.1, -0.73)
    assert model().plausible(sure, weights, right)
    assert not model().plausible(sure, weights, misread)
    ungated = RangeBearingParams(gate=1e9)
    assert model(ungated).plausible(sure, weights, misread)
    assert model().plausible(unsure, weights, RangeBearingReading(13, 5.0, -1.0))
    assert not model().plausible(sure, weights, RangeBearingReading(13, 5.0, -1.0))


@pytest.mark.parametrize(
    "reading",
    [
        RangeBearingReading(13, math.nan, 0.0),
        RangeBearingReading(13, 1.0, math.nan),
        RangeBearingReading(13, math.inf, 0.0),
        RangeBearingReading(99, 1.0, 0.0),
    ],
)
def test_a_reading_that_tells_nothing_favours_no_particle(reading: RangeBearingReading) -> None:
    particles = np.array([[0.0, 1.0], [3.0, 1.0], [0.0, 1.0]])
    assert not model().plausible(particles, np.array([0.5, 0.5]), reading)
    assert model().log_likelihood(particles, reading).tolist() == [0.0, 0.0]


def test_a_map_refuses_an_id_twice_and_positions_that_are_not_numbers() -> None:
    with pytest.raises(ValueError, match="landmark 6 is in the map twice"):
        LandmarkMap([(6, 0.0, 0.0), (6, 1.0, 0.0)])
    with pytest.raises(ValueError, match="landmark 7 lies at"):
        LandmarkMap([(7, math.nan, 0.0)])
    assert 6 not in LandmarkMap([])
    assert LANDMARKS.position(13).tolist() == [3.07964257, 0.24942861]
