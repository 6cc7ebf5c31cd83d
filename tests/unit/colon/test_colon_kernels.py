"""COLON's kernels against their textbook forms.

Tolerances: a log-likelihood is a sum of five logarithms, of densities whose exponents reach 100: float32 leaves 1e-5 of
each. A blame is a ratio of such densities. Displacements are sums of a few products of numbers up to 1e3.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.stats import multivariate_normal

from dynpf import kernels
from dynpf.colon.beams import Noise
from dynpf.colon.evidence import Beams, Bulges, Displacements, Stops, WallNoise
from dynpf.colon.wall import Wall
from dynpf.reference import colon as textbook

COUNT, BEAMS, NODES, SHAPES, SIZE = 7, 5, 6, 4, 40


def wall_of(rng: np.random.Generator) -> Wall:
    return Wall(
        beyond=rng.uniform(-20.0, 20.0, (SIZE, SIZE)).astype(np.float32),
        node=rng.integers(0, NODES, (SIZE, SIZE)).astype(np.int32),
        share=rng.uniform(0.0, 1.0, (SIZE, SIZE)).astype(np.float32),
        following=((np.arange(NODES) + 1) % NODES).astype(np.int32),
        places=np.zeros((2, NODES), dtype=np.int32),
        prior=np.eye(NODES, dtype=np.float32),
        shapes=rng.uniform(0.0, 1.0, (SHAPES, NODES)).astype(np.float32),
        near=np.tile(np.arange(SHAPES, dtype=np.int32), (NODES, 1)),
    )


def displacements_of(rng: np.random.Generator) -> Displacements:
    root = rng.normal(0.0, 8.0, (NODES, NODES))
    return Displacements(
        means=rng.normal(0.0, 10.0, (COUNT, NODES)).astype(np.float32),
        ancestors=rng.integers(0, COUNT, COUNT).astype(np.int32),
        covariance=(root @ root.T + np.eye(NODES)).astype(np.float32),
        chances=rng.uniform(0.05, 0.95, NODES).astype(np.float32),
    )


def bulges_of(rng: np.random.Generator) -> Bulges:
    return Bulges(
        log_shapes=np.log(rng.dirichlet(np.ones(SHAPES + 1), COUNT)).astype(np.float32),
        heights=rng.normal(40.0, 10.0, (COUNT, SHAPES)).astype(np.float32),
        variances=rng.uniform(20.0, 200.0, (COUNT, SHAPES)).astype(np.float32),
    )


def noise_of(sigma: float, outliers: float, roughness: float = 0.0, sigma_range: float = 0.0) -> WallNoise:
    return WallNoise(sigma, 5.0 * sigma, outliers, 30.0, roughness, sigma_range, bulge_roughness=0.0)


def ranges(rng: np.random.Generator) -> NDArray[np.float32]:
    read = rng.uniform(0.0, 25.0, BEAMS).astype(np.float32)
    read[rng.integers(0, BEAMS)] = rng.choice([np.nan, 30.0, read[0]])
    return read


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0), st.floats(0.001, 0.5))
def test_a_listed_map_is_as_likely_as_the_textbook_says(seed: int, sigma: float, outliers: float) -> None:
    rng = np.random.default_rng(seed)
    expected = rng.uniform(0.0, 30.0, (BEAMS, COUNT)).astype(np.float32)
    read, out = ranges(rng), np.empty(COUNT, dtype=np.float32)
    noise = Noise(sigma, 5.0 * sigma, outliers, 30.0)
    kernels.colon.listed(expected, read, noise, out)
    np.testing.assert_allclose(out, textbook.listed(expected, read, noise), rtol=1e-5, atol=1e-4)


def test_the_density_of_a_range_is_one_in_all_but_for_the_cap() -> None:
    errors = np.linspace(-200.0, 200.0, 400_001)
    total = trapezoid(textbook.beam_density(errors, Noise(2.0, 12.0, 0.1, 400.0)), errors)
    assert total == pytest.approx(1.0, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0), st.floats(0.5, 12.0))
def test_a_changed_map_is_as_likely_as_the_textbook_says(seed: int, sigma: float, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    walls, displacements = wall_of(rng), displacements_of(rng)
    x, y = rng.uniform(5, 35, (2, COUNT)).astype(np.float32)
    theta = rng.uniform(-3, 3, COUNT).astype(np.float32)
    angles = np.linspace(-1.0, 1.0, BEAMS).astype(np.float32)
    read, expected = ranges(rng), rng.uniform(0.0, 30.0, (BEAMS, COUNT)).astype(np.float32)
    beams, noise = Beams(x, y, theta, angles, read, expected), noise_of(sigma, 0.05, roughness, 2.0 * sigma)
    out, ours = np.empty(COUNT, dtype=np.float32), Stops.empty(BEAMS, COUNT)
    kernels.colon_walls.changed(beams, walls, displacements, noise, out, ours)
    told, theirs = textbook.changed(beams, walls, displacements, noise)
    # An end that lies half way between two cells may be taken for either: such particles are few.
    same = (ours.node == theirs.node).all(axis=0)
    assert same.sum() >= COUNT - 1
    np.testing.assert_allclose(out[same], told[same], rtol=1e-4, atol=2e-3)
    tolerances = {"blame": 2e-3, "distance": 1e-2, "variance": 1e-2, "facing": 1e-3, "unmoved": 1e-4}
    for name, tolerance in tolerances.items():
        found, expected = (getattr(stops, name)[:, same] for stops in (ours, theirs))
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=tolerance, err_msg=name)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0))
def test_walls_follow_beams_as_kalman_filters_do(seed: int, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    held, following = displacements_of(rng), wall_of(rng).following
    stops = Stops.empty(BEAMS, COUNT)
    stops.blame[:] = rng.choice([0.0, 0.3, 1.0], (BEAMS, COUNT))
    stops.distance[:] = rng.normal(0.0, 20.0, (BEAMS, COUNT))
    stops.node[:] = rng.integers(0, NODES, (BEAMS, COUNT))
    stops.node[rng.integers(0, BEAMS)] = -1
    stops.share[:] = rng.uniform(0.0, 1.0, (BEAMS, COUNT))
    stops.variance[:] = roughness**2 * rng.uniform(1.0, 2.0, (BEAMS, COUNT))
    weights = rng.uniform(0.1, 1.0, COUNT).astype(np.float32)
    learned = held.means.copy(), held.covariance.copy(), held.chances.copy()
    kernels.colon_walls.follow_walls(stops, following, weights, *learned)
    for ours, theirs in zip(learned, textbook.follow_walls(stops, following, weights, held), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=2e-2 * math.sqrt(held.covariance.max() / roughness**2))


def test_a_wall_seen_twice_is_where_two_independent_readings_say() -> None:
    """One node, one particle: the posterior of a Gaussian prior and two readings, in closed form."""
    displacement, covariance = np.zeros((1, 1), dtype=np.float32), np.array([[625.0]], dtype=np.float32)
    stops = Stops.empty(2, 1)
    stops.blame[:], stops.distance[:], stops.variance[:] = 1.0, [[40.0], [44.0]], 9.0
    stops.node[:], stops.share[:] = 0, 0.0
    following, weights, chances = np.zeros(1, np.int32), np.ones(1, np.float32), np.array([0.3], np.float32)
    kernels.colon_walls.follow_walls(stops, following, weights, displacement, covariance, chances)
    precision = 1 / 625 + 2 / 9
    assert covariance[0, 0] == pytest.approx(1 / precision, rel=1e-4)
    assert displacement[0, 0] == pytest.approx((40 + 44) / 9 / precision, rel=1e-4)
    assert chances[0] == pytest.approx(1.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_bulges_are_weighed_as_the_textbook_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls, ours = wall_of(rng), bulges_of(rng)
    stops, noise = Stops.empty(BEAMS, COUNT), noise_of(2.0, 0.05)._replace(bulge_roughness=rng.uniform(0.0, 4.0))
    stops.distance[:], stops.variance[:] = rng.normal(0.0, 20.0, (BEAMS, COUNT)), rng.uniform(1.0, 30.0, (BEAMS, COUNT))
    stops.facing[:], stops.unmoved[:] = rng.uniform(0.2, 1.0, (BEAMS, COUNT)), rng.uniform(1e-5, 0.1, (BEAMS, COUNT))
    stops.node[:], stops.share[:] = rng.integers(-1, NODES, (BEAMS, COUNT)), rng.uniform(0, 1, (BEAMS, COUNT))
    shapeless, out = rng.normal(-20.0, 5.0, COUNT).astype(np.float32), np.empty(COUNT, dtype=np.float32)
    total, theirs = textbook.bulged(stops, walls, noise, shapeless, ours)
    kernels.colon_bulges.bulged(stops, walls, noise, shapeless, out, ours)
    for found, expected in zip((out, *ours), (total, *theirs), strict=True):
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=5e-3)


def test_two_beams_into_one_bulge_are_as_likely_as_their_joint_gaussian() -> None:
    """One place, no outliers: the two distances are a Gaussian vector with the height in common."""
    stops, noise = Stops.empty(2, 1), noise_of(1.0, 0.0)
    stops.distance[:], stops.variance[:], stops.unmoved[:] = [[36.0], [20.0]], [[9.0], [4.0]], 1e-3
    stops.facing[:], stops.node[:], stops.share[:] = [[1.0], [0.5]], [[0], [1]], 0.0
    shapes, near = np.array([[1.0, 0.6]], np.float32), np.zeros((2, 1), dtype=np.int32)
    walls = wall_of(np.random.default_rng(0))._replace(following=np.arange(2, dtype=np.int32), shapes=shapes, near=near)
    bulges = Bulges(
        np.array([[0.0, -60.0]], np.float32), np.full((1, 1), 40.0, np.float32), np.full((1, 1), 225.0, np.float32)
    )
    out, shapeless = np.empty(1, np.float32), np.zeros(1, np.float32)
    kernels.colon_bulges.bulged(stops, walls, noise, shapeless, out, bulges)
    reach = np.array([1.0, 0.6])
    joint = multivariate_normal(40.0 * reach, 225.0 * np.outer(reach, reach) + np.diag([9.0, 4.0]))
    assert out[0] == pytest.approx(joint.logpdf([36.0, 20.0]) + math.log(0.5), abs=1e-3)
    precision = 1 / 225 + 1 / 9 + 0.6**2 / 4
    assert bulges.variances[0, 0] == pytest.approx(1 / precision, rel=1e-3)
    assert bulges.heights[0, 0] == pytest.approx((40 / 225 + 36 / 9 + 0.6 * 20 / 4) / precision, rel=1e-4)


def test_maps_give_way_as_a_markov_chain_does() -> None:
    rng = np.random.default_rng(1)
    maps, since = rng.dirichlet(np.ones(3), COUNT).T.astype(np.float32), rng.uniform(0, 5, (3, COUNT))
    transition = rng.dirichlet(np.ones(3), 3).astype(np.float32)
    now, begun, fresh = np.empty((3, COUNT), np.float32), np.empty((3, COUNT), np.float32), np.empty(COUNT, np.float32)
    since = since.astype(np.float32)
    kernels.colon.given_way(maps, since, transition, np.float32(6.0), now, begun, fresh)
    told = transition.T @ maps
    stayed = np.diag(transition)[:, None] * maps / told
    np.testing.assert_allclose(now, told, rtol=1e-6)
    np.testing.assert_allclose(begun, stayed * since + (1 - stayed) * 6.0, rtol=1e-5)
    np.testing.assert_allclose(fresh, 1 - stayed[-1], atol=1e-6)


def test_bulges_that_begin_are_mixed_in_by_their_moments() -> None:
    rng = np.random.default_rng(2)
    bulges = bulges_of(rng)
    log_shapes, heights, variances = (values.copy() for values in bulges)
    fresh = rng.uniform(0, 1, COUNT).astype(np.float32)
    begun = np.log(rng.dirichlet(np.ones(SHAPES + 1))).astype(np.float32)
    old, new = (1 - fresh)[:, None] * np.exp(log_shapes), fresh[:, None] * np.exp(begun)
    kept = (old / (old + new))[:, :-1]
    mean = kept * heights + (1 - kept) * 30.0
    second = kept * (variances + heights**2) + (1 - kept) * (100.0 + 30.0**2)
    kernels.colon_bulges.bulges_given_way(bulges, fresh, begun, 30.0, 100.0, 4.0)
    np.testing.assert_allclose(bulges.log_shapes, np.log(old + new), atol=2e-6)
    np.testing.assert_allclose(bulges.heights, mean, rtol=1e-5)
    np.testing.assert_allclose(bulges.variances, second - mean**2 + 4.0, rtol=1e-3)


def test_maps_are_weighed_by_bayes_rule_and_one_that_is_impossible_stays_so() -> None:
    rng = np.random.default_rng(3)
    maps = rng.dirichlet(np.ones(3), COUNT).T.astype(np.float32)
    maps[:, 0] = 0.0, 1.0, 0.0
    ancestors = rng.permutation(COUNT).astype(np.int32)
    likelihood = rng.normal(-300.0, 5.0, (3, COUNT)).astype(np.float32)
    posterior, total = np.empty((3, COUNT), np.float32), np.empty(COUNT, np.float32)
    kernels.colon.weighed(maps, ancestors, likelihood, posterior, total)
    with np.errstate(divide="ignore"):
        joint = np.log(maps[:, ancestors].astype(float)) + likelihood
    np.testing.assert_allclose(total, np.logaddexp.reduce(joint, axis=0), rtol=1e-6)
    np.testing.assert_allclose(posterior, np.exp(joint - np.logaddexp.reduce(joint, axis=0)), atol=1e-4)
    assert posterior[:, ancestors == 0].ravel().tolist() == [0.0, 1.0, 0.0]


def test_walls_are_expected_where_bulges_and_what_has_no_shape_together_put_them() -> None:
    rng = np.random.default_rng(4)
    held, bulges, unlisted = displacements_of(rng), bulges_of(rng), rng.dirichlet(np.ones(COUNT))
    shapes, out = wall_of(rng).shapes, np.empty(NODES)
    kernels.colon_bulges.displaced(unlisted, bulges, held.means, held.chances, shapes, out)
    shares = np.exp(bulges.log_shapes.astype(np.float64))
    shapeless = np.where(held.chances > 0.5, (unlisted * shares[:, -1]) @ held.means, 0.0)
    np.testing.assert_allclose(out, shapeless + unlisted @ (shares[:, :-1] * bulges.heights) @ shapes, rtol=1e-5)


def test_the_bearable_share_of_a_likelihood_leaves_the_effective_particles_that_it_is_to_leave() -> None:
    rng = np.random.default_rng(5)
    log_weights, likelihood = np.zeros(200, np.float32), rng.normal(0.0, 30.0, 200).astype(np.float32)
    share = kernels.colon.bearable(log_weights, likelihood, 1.0, 0.5)
    weights = np.exp(share * likelihood.astype(float))
    assert 0.0 < share < 1.0
    assert weights.sum() ** 2 / np.sum(weights**2) == pytest.approx(100.0, rel=1e-3)
    assert kernels.colon.bearable(log_weights, 0.001 * likelihood, 1.0, 0.5) == 1.0
    assert kernels.colon.bearable(log_weights, 1e30 * likelihood, 1.0, 0.5) == 0.0
