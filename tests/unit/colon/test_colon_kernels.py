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
    total = np.trapezoid(textbook.beam_density(errors, 2.0, 12.0, 0.1, 400.0), errors)
    assert total == pytest.approx(1.0, abs=1e-6)


def changed(rng: np.random.Generator, held: Walls, sigma: float, roughness: float) -> tuple[list, list]:
    poses = np.stack((rng.uniform(5, 35, COUNT), rng.uniform(5, 35, COUNT), rng.uniform(-3, 3, COUNT)))
    poses = poses.astype(np.float32)
    angles = np.linspace(-1.0, 1.0, BEAMS).astype(np.float32)
    read, expected = ranges(rng), rng.uniform(0.0, 30.0, (BEAMS, COUNT)).astype(np.float32)
    out = [np.empty(COUNT, dtype=np.float32), *(np.empty((BEAMS, COUNT), dtype=np.float32) for _ in range(2))]
    out += [np.empty((BEAMS, COUNT), dtype=np.int32), np.empty((BEAMS, COUNT), dtype=np.float32)]
    kernels.colon.changed(*poses, angles, read, expected, *held, sigma, 5.0 * sigma, roughness, 0.05, 30.0, *out)
    map_tables, (displacement, ancestors), rest = held[:4], held[4:6], held[6:]
    own = displacement[ancestors]
    told = textbook.changed(
        poses, angles, read, expected, *map_tables, own, *rest, sigma, 5.0 * sigma, roughness, 0.05, 30.0
    )
    return out, list(told)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 12.0), st.floats(0.5, 12.0))
def test_a_changed_map_is_as_likely_as_the_textbook_says(seed: int, sigma: float, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    out, told = changed(rng, walls(rng), sigma, roughness)
    # An end that lies half way between two cells may be taken for either: such particles are few.
    same = (out[3] == told[3]).all(axis=0)
    assert same.sum() >= COUNT - 1
    for ours, theirs, tolerance in zip(out[:3], told[:3], (2e-3, 2e-3, 1e-2), strict=True):
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
    seen = blame, stopped_at, places, shares, held.following, roughness, weights
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
    kernels.colon.follow_walls(*beams, places, shares, following, 3.0, weights, displacement, covariance, chances)
    precision = 1 / 625 + 2 / 9
    assert covariance[0, 0] == pytest.approx(1 / precision, rel=1e-4)
    assert displacement[0, 0] == pytest.approx((40 + 44) / 9 / precision, rel=1e-4)
    assert chances[0] == pytest.approx(1.0)
