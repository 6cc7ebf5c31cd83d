import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from dynpf.measurement.beam import BeamParams, densities
from dynpf.measurement.beam_fit import fit_beam

RANGE_MAX = 10.0
PLANTED = BeamParams(z_hit=0.6, z_short=0.2, z_max=0.08, z_rand=0.12, sigma_hit=0.12, lambda_short=0.8)
START = BeamParams(z_hit=0.25, z_short=0.25, z_max=0.25, z_rand=0.25, sigma_hit=0.5, lambda_short=0.2)


def planted_pairs(count, seed, params=PLANTED):
    draw = np.random.default_rng(seed)
    expected = draw.uniform(0.1, 9.9, count)
    part = draw.choice(4, size=count, p=[params.z_hit, params.z_short, params.z_max, params.z_rand])
    sigma, decay = params.sigma_hit, params.lambda_short
    hit = stats.truncnorm(-expected / sigma, (RANGE_MAX - expected) / sigma, loc=expected, scale=sigma)
    short = stats.truncexpon(decay * expected, scale=1.0 / decay)
    parts = (hit.rvs(random_state=draw), short.rvs(random_state=draw), np.full(count, RANGE_MAX))
    return np.choose(part, (*parts, draw.uniform(0.0, RANGE_MAX, count))), expected


def free_values(params):
    return np.array([params.z_hit, params.z_short, params.z_max, params.sigma_hit, params.lambda_short])


def log_densities(values, z, expected):
    shares = np.array([*values[:3], 1.0 - values[:3].sum()])
    return np.log(shares @ densities(z, expected, RANGE_MAX, values[3], values[4]))


def standard_errors(values, z, expected):
    """Return those of the maximum-likelihood estimate, from the scores of the readings (Fisher's information)."""
    steps = 1e-5 * np.eye(5)
    scores = np.stack(
        [(log_densities(values + s, z, expected) - log_densities(values - s, z, expected)) / 2e-5 for s in steps]
    )
    return np.sqrt(np.diag(np.linalg.inv(np.einsum("in,jn->ij", scores, scores))))


def test_planted_parameters_are_found_within_their_standard_errors():
    z, expected = planted_pairs(8000, 1)
    fit = fit_beam(z, expected, RANGE_MAX, START)
    planted = free_values(PLANTED)
    errors = standard_errors(planted, z, expected)
    assert fit.converged
    assert fit.used == 8000
    assert (np.abs(free_values(fit.params) - planted) < 3.5 * errors).all()
    assert (np.abs(free_values(START) - planted) > 5.0 * errors).all()
    assert errors.max() < 0.06


def test_truncation_does_not_bias_the_scales():
    wide = BeamParams(z_hit=0.9, z_short=0.1, z_max=0.0, z_rand=0.0, sigma_hit=3.0, lambda_short=0.3)
    z, expected = planted_pairs(8000, 2, wide)
    start = BeamParams(z_hit=0.9, z_short=0.1, z_max=0.0, z_rand=0.0, sigma_hit=1.0, lambda_short=0.3)
    fit = fit_beam(z, expected, RANGE_MAX, start)
    assert fit.params.sigma_hit == pytest.approx(3.0, rel=0.06)
    # What the book's formula makes of it, which knows of no truncation.
    assert np.sqrt(np.mean((z - expected) ** 2)) < 2.8


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 12.0), st.floats(0.01, 9.99)), min_size=1, max_size=30),
    st.floats(0.01, 5.0),
    st.floats(0.01, 5.0),
    st.lists(st.floats(0.05, 1.0), min_size=4, max_size=4),
)
def test_the_log_likelihood_never_falls(pairs, sigma, decay, weights):
    shares = dict(
        zip(("z_hit", "z_short", "z_max", "z_rand"), (np.array(weights) / sum(weights)).tolist(), strict=True)
    )
    start = BeamParams(**shares, sigma_hit=sigma, lambda_short=decay)
    z, expected = np.array(pairs).T
    fit = fit_beam(z, expected, RANGE_MAX, start, max_iterations=60)
    assert (np.diff(fit.log_likelihoods) >= -1e-8 * (1.0 + np.abs(fit.log_likelihoods[1:]))).all()
    assert len(fit.log_likelihoods) <= 61


def test_parts_that_explain_nothing_lose_their_share_and_keep_their_scale():
    fit = fit_beam(np.full(20, 30.0), np.full(20, 4.0), RANGE_MAX, PLANTED)
    assert fit.params.z_max == pytest.approx(1.0, abs=1e-6)
    assert (fit.params.sigma_hit, fit.params.lambda_short) == (PLANTED.sigma_hit, PLANTED.lambda_short)
    exact = np.linspace(1.0, 9.0, 50)
    fit = fit_beam(exact, exact, RANGE_MAX, PLANTED)
    assert fit.params.z_hit == pytest.approx(1.0, abs=1e-3)
    assert fit.params.sigma_hit == 1e-4


def test_only_pairs_that_tell_something_are_used():
    z, expected = planted_pairs(200, 3)
    bad = np.array([[np.nan, 2.0], [2.0, np.nan], [-1.0, 2.0], [RANGE_MAX, RANGE_MAX], [3.0, 50.0], [1.0, 0.0]])
    with_bad = fit_beam(np.append(z, bad[:, 0]), np.append(expected, bad[:, 1]), RANGE_MAX, START)
    assert with_bad.used == 200
    assert with_bad.params == fit_beam(z, expected, RANGE_MAX, START).params


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(ValueError, match=r"ranges \(2,\) and expected \(1,\)"):
        fit_beam([1.0, 2.0], [1.0], RANGE_MAX, START)
    with pytest.raises(ValueError, match="of 1 pairs none"):
        fit_beam([np.nan], [1.0], RANGE_MAX, START)
    with pytest.raises(ValueError, match="range_max = inf"):
        fit_beam([1.0], [1.0], np.inf, START)
    only_short = BeamParams(z_hit=0.0, z_short=1.0, z_max=0.0, z_rand=0.0)
    with pytest.raises(ValueError, match=r"range 2.0 m is impossible"):
        fit_beam([2.0], [1.0], RANGE_MAX, only_short)
