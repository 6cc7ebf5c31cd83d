"""COLON's kernels against their textbook forms.

Tolerances: a log-likelihood is a sum of five logarithms, of densities whose exponents reach 100: float32 leaves 1e-5 of
each. A blame is a ratio of such densities. Displacements are sums of a few products of numbers up to 1e3.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from scipy.stats import multivariate_normal

from dynpf import kernels
from dynpf.reference import colon as textbook

COUNT, BEAMS, NODES, SIZE = 7, 5, 6, 40


class Walls(NamedTuple):
    beyond: np.ndarray
    node: np.ndarray
    share: np.ndarray
    following: np.ndarray
    displacement: np.ndarray
    ancestors: np.ndarray
    covariance: np.ndarray
    chances: np.ndarray


def walls(rng: np.random.Generator) -> Walls:
    root = rng.normal(0.0, 8.0, (NODES, NODES))
    return Walls(
        rng.uniform(-20.0, 20.0, (SIZE, SIZE)).astype(np.float32),
        rng.integers(0, NODES, (SIZE, SIZE)).astype(np.int32),
        rng.uniform(0.0, 1.0, (SIZE, SIZE)).astype(np.float32),
        ((np.arange(NODES) + 1) % NODES).astype(np.int32),
        rng.normal(0.0, 10.0, (COUNT, NODES)).astype(np.float32),
        rng.integers(0, COUNT, COUNT).astype(np.int32),
        (root @ root.T + np.eye(NODES)).astype(np.float32),
        rng.uniform(0.05, 0.95, NODES).astype(np.float32),
    )


def ranges(rng: np.random.Generator) -> np.ndarray:
    read = rng.uniform(0.0, 25.0, BEAMS).astype(np.float32)
    read[rng.integers(0, BEAMS)] = rng.choice([np.nan, 30.0, read[0]])
    return read


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0), st.floats(0.001, 0.5))
def test_a_listed_map_is_as_likely_as_the_textbook_says(seed: int, sigma: float, outliers: float) -> None:
    rng = np.random.default_rng(seed)
    expected = rng.uniform(0.0, 30.0, (BEAMS, COUNT)).astype(np.float32)
    read, out = ranges(rng), np.empty(COUNT, dtype=np.float32)
    kernels.colon.listed(expected, read, sigma, 5.0 * sigma, outliers, 30.0, out)
    np.testing.assert_allclose(
        out, textbook.listed(expected, read, sigma, 5.0 * sigma, outliers, 30.0), rtol=1e-5, atol=1e-4
    )


def test_the_density_of_a_range_is_one_in_all_but_for_the_cap() -> None:
    errors = np.linspace(-200.0, 200.0, 400_001)
    total = trapezoid(textbook.beam_density(errors, 2.0, 12.0, 0.1, 400.0), errors)
    assert total == pytest.approx(1.0, abs=1e-6)


def changed(rng: np.random.Generator, held: Walls, sigma: float, roughness: float) -> tuple[list, list]:
    sensed = 2.0 * sigma
    poses = np.stack((rng.uniform(5, 35, COUNT), rng.uniform(5, 35, COUNT), rng.uniform(-3, 3, COUNT)))
    poses = poses.astype(np.float32)
    angles = np.linspace(-1.0, 1.0, BEAMS).astype(np.float32)
    read, expected = ranges(rng), rng.uniform(0.0, 30.0, (BEAMS, COUNT)).astype(np.float32)
    out = [np.empty(COUNT, dtype=np.float32), *(np.empty((BEAMS, COUNT), dtype=np.float32) for _ in range(5))]
    out += [np.empty((BEAMS, COUNT), dtype=np.int32), np.empty((BEAMS, COUNT), dtype=np.float32)]
    kernels.colon.changed(
        *poses, angles, read, expected, *held, sigma, 5.0 * sigma, roughness, sensed, 0.05, 30.0, *out
    )
    map_tables, (displacement, ancestors), rest = held[:4], held[4:6], held[6:]
    own = displacement[ancestors]
    told = textbook.changed(
        poses, angles, read, expected, *map_tables, own, *rest, sigma, 5.0 * sigma, roughness, sensed, 0.05, 30.0
    )
    return out, list(told)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0), st.floats(0.5, 12.0))
def test_a_changed_map_is_as_likely_as_the_textbook_says(seed: int, sigma: float, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    out, told = changed(rng, walls(rng), sigma, roughness)
    # An end that lies half way between two cells may be taken for either: such particles are few.
    same = (out[6] == told[6]).all(axis=0)
    assert same.sum() >= COUNT - 1
    for ours, theirs, tolerance in zip(out[:6], told[:6], (2e-3, 2e-3, 1e-2, 1e-2, 1e-3, 1e-4), strict=True):
        np.testing.assert_allclose(ours[..., same], theirs[..., same], rtol=1e-4, atol=tolerance)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0))
def test_walls_follow_beams_as_kalman_filters_do(seed: int, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    held = walls(rng)
    blame = rng.choice([0.0, 0.3, 1.0], (BEAMS, COUNT)).astype(np.float32)
    stopped_at = rng.normal(0.0, 20.0, (BEAMS, COUNT)).astype(np.float32)
    places = rng.integers(0, NODES, (BEAMS, COUNT)).astype(np.int32)
    places[rng.integers(0, BEAMS)] = -1
    shares = rng.uniform(0.0, 1.0, (BEAMS, COUNT)).astype(np.float32)
    weights = rng.uniform(0.1, 1.0, COUNT).astype(np.float32)
    learned = held.displacement.copy(), held.covariance.copy(), held.chances.copy()
    noise = (roughness**2 * rng.uniform(1.0, 2.0, (BEAMS, COUNT))).astype(np.float32)
    seen = blame, stopped_at, noise, places, shares, held.following, weights
    kernels.colon.follow_walls(*seen, *learned)
    for ours, theirs in zip(
        learned, textbook.follow_walls(*seen, held.displacement, held.covariance, held.chances), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=2e-2 * math.sqrt(held.covariance.max() / roughness**2))


def test_a_wall_seen_twice_is_where_two_independent_readings_say() -> None:
    """One node, one particle: the posterior of a Gaussian prior and two readings, in closed form."""
    displacement, covariance = np.zeros((1, 1), dtype=np.float32), np.array([[625.0]], dtype=np.float32)
    beams = np.array([[1.0], [1.0]], dtype=np.float32), np.array([[40.0], [44.0]], dtype=np.float32)
    places, shares = np.zeros((2, 1), dtype=np.int32), np.zeros((2, 1), dtype=np.float32)
    following, weights, chances = np.zeros(1, np.int32), np.ones(1, np.float32), np.array([0.3], np.float32)
    noise = np.full((2, 1), 9.0, dtype=np.float32)
    kernels.colon.follow_walls(*beams, noise, places, shares, following, weights, displacement, covariance, chances)
    precision = 1 / 625 + 2 / 9
    assert covariance[0, 0] == pytest.approx(1 / precision, rel=1e-4)
    assert displacement[0, 0] == pytest.approx((40 + 44) / 9 / precision, rel=1e-4)
    assert chances[0] == pytest.approx(1.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_bulges_are_weighed_as_the_textbook_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = [rng.normal(0.0, 20.0, (BEAMS, COUNT)), rng.uniform(1.0, 30.0, (BEAMS, COUNT))]
    found += [rng.uniform(0.2, 1.0, (BEAMS, COUNT)), rng.uniform(1e-5, 0.1, (BEAMS, COUNT))]
    places = rng.integers(-1, NODES, (BEAMS, COUNT)).astype(np.int32)
    beams = [*(a.astype(np.float32) for a in found), places, rng.uniform(0, 1, (BEAMS, COUNT)).astype(np.float32)]
    shapes = rng.uniform(0.0, 1.0, (4, NODES)).astype(np.float32)
    near = np.tile(np.arange(4, dtype=np.int32), (NODES, 1))
    following = ((np.arange(NODES) + 1) % NODES).astype(np.int32)
    generic, out = rng.normal(-20.0, 5.0, COUNT).astype(np.float32), np.empty(COUNT, dtype=np.float32)
    held = [np.log(rng.dirichlet(np.ones(5), COUNT)), rng.normal(40, 10, (COUNT, 4)), rng.uniform(20, 200, (COUNT, 4))]
    log_shapes, heights, variances = (a.astype(np.float32) for a in held)
    told = textbook.bulged(*beams, following, shapes, 0.05, 500.0, generic, log_shapes, heights, variances)
    kernels.colon.bulged(*beams, following, shapes, near, 0.05, 500.0, generic, out, log_shapes, heights, variances)
    for ours, theirs in zip((out, log_shapes, heights, variances), told, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=5e-3)


def test_two_beams_into_one_bulge_are_as_likely_as_their_joint_gaussian() -> None:
    """One place, no outliers: the two distances are a Gaussian vector with the height in common."""
    stopped_at, noise = np.array([[36.0], [20.0]], np.float32), np.array([[9.0], [4.0]], np.float32)
    facings, still = np.array([[1.0], [0.5]], np.float32), np.full((2, 1), 1e-3, dtype=np.float32)
    places, shares, following = (
        np.array([[0], [1]], np.int32),
        np.zeros((2, 1), np.float32),
        np.arange(2, dtype=np.int32),
    )
    shapes, near = np.array([[1.0, 0.6]], np.float32), np.zeros((2, 1), dtype=np.int32)
    log_shapes = np.array([[0.0, -60.0]], dtype=np.float32)
    heights, variances = np.full((1, 1), 40.0, np.float32), np.full((1, 1), 225.0, np.float32)
    out, generic = np.empty(1, np.float32), np.zeros(1, np.float32)
    beams = stopped_at, noise, facings, still, places, shares
    kernels.colon.bulged(*beams, following, shapes, near, 0.0, 500.0, generic, out, log_shapes, heights, variances)
    reach = np.array([1.0, 0.6])
    joint = multivariate_normal(40.0 * reach, 225.0 * np.outer(reach, reach) + np.diag([9.0, 4.0]))
    assert out[0] == pytest.approx(joint.logpdf([36.0, 20.0]) + math.log(0.5), abs=1e-3)
    precision = 1 / 225 + 1 / 9 + 0.6**2 / 4
    assert variances[0, 0] == pytest.approx(1 / precision, rel=1e-3)
    assert heights[0, 0] == pytest.approx((40 / 225 + 36 / 9 + 0.6 * 20 / 4) / precision, rel=1e-4)


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
    log_shapes = np.log(rng.dirichlet(np.ones(5), COUNT)).astype(np.float32)
    heights, variances = rng.normal(40, 10, (COUNT, 4)), rng.uniform(20, 200, (COUNT, 4))
    heights, variances = heights.astype(np.float32), variances.astype(np.float32)
    fresh, begun = rng.uniform(0, 1, COUNT).astype(np.float32), np.log(rng.dirichlet(np.ones(5))).astype(np.float32)
    old, new = (1 - fresh)[:, None] * np.exp(log_shapes), fresh[:, None] * np.exp(begun)
    kept = (old / (old + new))[:, :-1]
    mean = kept * heights + (1 - kept) * 30.0
    second = kept * (variances + heights**2) + (1 - kept) * (100.0 + 30.0**2)
    kernels.colon.bulges_given_way(log_shapes, heights, variances, fresh, begun, 30.0, 100.0, 4.0)
    np.testing.assert_allclose(log_shapes, np.log(old + new), atol=2e-6)
    np.testing.assert_allclose(heights, mean, rtol=1e-5)
    np.testing.assert_allclose(variances, second - mean**2 + 4.0, rtol=1e-3)


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
    held, unlisted = walls(rng), rng.dirichlet(np.ones(COUNT))
    shares, heights = rng.dirichlet(np.ones(5), COUNT), rng.normal(40, 10, (COUNT, 4)).astype(np.float32)
    shapes, out = rng.uniform(0.0, 1.0, (4, NODES)).astype(np.float32), np.empty(NODES)
    log_shapes = np.log(shares).astype(np.float32)
    kernels.colon.displaced(unlisted, log_shapes, heights, held.displacement, held.chances, shapes, out)
    shapeless = np.where(held.chances > 0.5, (unlisted * shares[:, -1]) @ held.displacement, 0.0)
    np.testing.assert_allclose(out, shapeless + unlisted @ (shares[:, :-1] * heights) @ shapes, rtol=1e-5)


def test_the_bearable_share_of_a_likelihood_leaves_the_effective_particles_that_it_is_to_leave() -> None:
    rng = np.random.default_rng(5)
    log_weights, likelihood = np.zeros(200, np.float32), rng.normal(0.0, 30.0, 200).astype(np.float32)
    share = kernels.colon.bearable(log_weights, likelihood, 1.0, 0.5)
    weights = np.exp(share * likelihood.astype(float))
    assert 0.0 < share < 1.0
    assert weights.sum() ** 2 / np.sum(weights**2) == pytest.approx(100.0, rel=1e-3)
    assert kernels.colon.bearable(log_weights, 0.001 * likelihood, 1.0, 0.5) == 1.0
    assert kernels.colon.bearable(log_weights, 1e30 * likelihood, 1.0, 0.5) == 0.0
