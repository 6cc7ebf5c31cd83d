"""How many particles a filter needs, and when it doubts all of them."""

import math
from statistics import NormalDist

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from dynpf.filters.adaptation import (
    Augmented,
    AugmentedParams,
    Kld,
    KldParams,
    Recovery,
    SensorResetting,
    SensorResettingParams,
    kld_bound,
    log_average,
)
from dynpf.rng import generator
from dynpf.se2 import Floats


def uniform(seed: int, count: int, extent: float) -> Floats:
    drawn = generator(seed, "test", 0).uniform(-1.0, 1.0, (3, count))
    spread: Floats = drawn * np.array([[extent], [extent], [math.pi]])
    return spread.astype(np.float32)


def even(count: int) -> Floats:
    return np.full(count, 1.0 / count, dtype=np.float32)


@settings(derandomize=True, deadline=None)
@given(cells=st.integers(2, 100_000), epsilon=st.floats(0.001, 1.0), probability=st.floats(0.9, 0.999))
def test_the_bound_is_the_quantile_of_chi_square(cells: int, epsilon: float, probability: float) -> None:
    exact = chi2.ppf(probability, cells - 1) / (2.0 * epsilon)
    # Wilson and Hilferty's approximation is worst for one degree of freedom: 3 %.
    assert kld_bound(cells, epsilon, NormalDist().inv_cdf(probability)) == pytest.approx(
        exact, rel=0.035 / (cells - 1) + 0.001
    )


def test_the_bound_keeps_what_it_promises() -> None:
    """Of draws from a known distribution over k cells, about 1 - probability diverge by more than epsilon."""
    cells, epsilon, probability = 50, 0.05, 0.9
    count = math.ceil(kld_bound(cells, epsilon, NormalDist().inv_cdf(probability)))
    shares = np.random.default_rng(1).multinomial(count, np.full(cells, 1.0 / cells), size=2000) / count
    divergence = np.sum(np.where(shares > 0.0, shares * np.log(np.maximum(shares, 1e-9) * cells), 0.0), axis=1)
    assert np.mean(divergence > epsilon) == pytest.approx(1.0 - probability, abs=0.03)


def test_a_cloud_within_one_cell_needs_the_least_and_a_wide_one_more_up_to_the_most() -> None:
    kld = Kld(KldParams(n_min=50, n_max=20_000))
    assert kld.size(np.full((3, 1000), 0.1, dtype=np.float32), even(1000)) == 50
    assert kld.size(np.zeros((3, 1), dtype=np.float32), even(1)) == 50
    small, large = (kld.size(uniform(2, 10_000, extent), even(10_000)) for extent in (0.5, 1.5))
    assert 50 < small < large < 20_000
    assert kld.size(uniform(2, 10_000, 50.0), even(10_000)) == 20_000


def test_all_weight_on_one_particle_is_one_cell() -> None:
    particles, weights = uniform(3, 1000, 10.0), np.zeros(1000, dtype=np.float32)
    weights[321] = 1.0
    assert Kld(KldParams()).cells(particles, weights) == 1


@settings(derandomize=True, deadline=None, max_examples=40)
@given(count=st.integers(1, 500), seed=st.integers(0, 10**6), extent=st.floats(0.1, 20.0))
def test_equal_weights_count_every_cell_whatever_the_order(count: int, seed: int, extent: float) -> None:
    particles = uniform(seed, count, extent)
    kld = Kld(KldParams(cell_x=0.5, cell_y=1.0, cell_heading=math.pi / 4))
    turns = np.minimum(np.floor((particles[2].astype(float) % (2.0 * math.pi)) / (math.pi / 4)), 7)
    cells = {*zip(np.floor(particles[0] * 2.0), np.floor(particles[1]), turns, strict=True)}
    shuffled = particles[:, generator(seed, "order", 0).permutation(count)]
    assert kld.cells(particles, even(count)) == kld.cells(shuffled, even(count)) == len(cells)


def test_particles_that_will_hardly_survive_do_not_count() -> None:
    particles = uniform(4, 2000, 10.0)
    weights = np.where(np.arange(2000) < 1000, 1.0, 1e-3).astype(np.float32)
    kld = Kld(KldParams())
    halves = kld.cells(particles[:, :1000], even(1000))
    assert halves <= kld.cells(particles, weights) <= halves + 5
    # Control: with weight they do.
    assert kld.cells(particles, even(2000)) > 1.3 * halves


def test_particles_that_are_not_finite_are_in_no_cell() -> None:
    particles = uniform(5, 50, 0.1)
    kld = Kld(KldParams())
    whole = kld.cells(particles, even(50))
    damaged = np.concatenate([particles, np.full((3, 3), np.nan, dtype=np.float32)], axis=1)
    assert kld.cells(damaged, even(53)) == whole
    assert kld.cells(np.zeros((3, 0), dtype=np.float32), np.zeros(0, dtype=np.float32)) == 0


def test_augmented_follows_the_textbook() -> None:
    """Thrun, Burgard and Fox (2005), table 8.3, in plain likelihoods, its averages beginning at the first."""
    recovery = Augmented(AugmentedParams(alpha_slow=0.05, alpha_fast=0.4))
    memory = recovery.begin()
    slow = fast = 0.3
    for likelihood in (0.3, 0.5, 0.2, 0.01, 0.02, 0.4):
        slow += 0.05 * (likelihood - slow)
        fast += 0.4 * (likelihood - fast)
        memory, share = recovery.assess(memory, math.log(likelihood))
        assert share == pytest.approx(max(0.0, 1.0 - fast / slow))
    assert memory == pytest.approx((math.log(slow), math.log(fast)))


def test_augmented_survives_likelihoods_that_underflow() -> None:
    recovery = Augmented(AugmentedParams())
    memory, _ = recovery.assess(recovery.begin(), -5000.0)
    _, share = recovery.assess(memory, -9000.0)
    assert share == pytest.approx(1.0 - 0.9 / 0.999)


def test_impossible_readings_raise_the_share_to_its_limit_and_good_ones_lower_it() -> None:
    recovery = Augmented(AugmentedParams(alpha_fast=0.5, share_max=0.8))
    memory, share = recovery.assess(recovery.begin(), -1.0)
    assert share == 0.0
    for _ in range(10):
        memory, share = recovery.assess(memory, -math.inf)
    assert share == 0.8
    for _ in range(10):
        memory, share = recovery.assess(memory, -1.0)
    assert share < 0.01
    # Nothing was ever possible: there is nothing to lose.
    assert recovery.assess(recovery.begin(), -math.inf)[1] == 0.8


def test_sensor_resetting_goes_by_the_newest_readings() -> None:
    recovery = SensorResetting(SensorResettingParams(log_likelihood=-2.0))
    shares = [recovery.assess((), value)[1] for value in (0.0, -2.0, -2.0 + math.log(0.25), -math.inf)]
    assert shares == pytest.approx([0.0, 0.0, 0.75, 1.0])


@pytest.mark.parametrize(
    "recovery", [Augmented(AugmentedParams()), SensorResetting(SensorResettingParams(log_likelihood=0.0))]
)
def test_readings_of_an_update_count_as_one_of_their_geometric_mean(recovery: Recovery) -> None:
    memory, _ = recovery.assess(recovery.begin(), -1.0, 1)
    assert recovery.assess(memory, -120.0, 60) == recovery.assess(memory, -2.0, 1)
    # Control: together they would be hopeless.
    assert recovery.assess(memory, -120.0, 1)[1] > recovery.assess(memory, -2.0, 1)[1]
    for nothing in ((math.nan, 1), (math.inf, 1), (-3.0, 0)):
        assert recovery.assess(memory, *nothing) == (memory, 0.0)


def test_the_memory_can_be_kept_as_plain_numbers() -> None:
    recovery = Augmented(AugmentedParams())
    for memory in (recovery.begin(), recovery.assess(recovery.begin(), -3.0)[0]):
        kept = tuple(msgspec.msgpack.decode(msgspec.msgpack.encode(memory)))
        assert recovery.assess(kept, -7.0) == recovery.assess(memory, -7.0)


def test_averages_of_logarithms_are_those_of_the_values() -> None:
    assert math.exp(log_average(math.log(0.2), math.log(0.6), 0.25)) == pytest.approx(0.3)
    assert log_average(-math.inf, -math.inf, 0.5) == -math.inf
    assert log_average(-math.inf, -4.0, 1.0) == -4.0


def test_parameters_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match=r"KldParams.epsilon = -1.0"):
        Kld(KldParams(epsilon=-1.0))
    with pytest.raises(ValueError, match="n_min = 5 is above n_max = 2"):
        KldParams(n_min=5, n_max=2)
    with pytest.raises(ValueError, match="alpha_slow"):
        AugmentedParams(alpha_slow=0.5, alpha_fast=0.5)
