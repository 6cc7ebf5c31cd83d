"""Particle filter with the optimal importance density, for Gaussian noise and a state measured directly.

The particles are drawn from p(x_k | x_{k-1}, z_k) itself, which is Gaussian here, and weighted by
p(z_k | x_{k-1}), which does not depend on what was drawn (PARTS eq. 3.18-3.23).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.filters.resampling import effective_sample_size, normalize_log_weights, systematic

__all__ = ["Particles", "draw_initial", "mean_and_covariance", "propagate", "resample_if_needed", "update"]

FloatArray = NDArray[np.float64]


class Particles(NamedTuple):
    """States, shape (N, d), and their normalized weights, shape (N,)."""

    states: FloatArray
    weights: FloatArray


def draw_initial(measurement: FloatArray, covariance: FloatArray, count: int, random: np.random.Generator) -> Particles:
    """Return ``count`` equally weighted draws from N(measurement, covariance) (PARTS table 3.1, step 1)."""
    noise = _gaussian(np.zeros((count, measurement.size)), covariance, random)
    return Particles(measurement + noise, np.full(count, 1.0 / count))


def propagate(
    particles: Particles, predicted: FloatArray, process_covariance: FloatArray, random: np.random.Generator
) -> Particles:
    """Return the particles at ``predicted`` = f(x), (N, d), plus process noise: a step without measurement."""
    return Particles(_gaussian(predicted, process_covariance, random), particles.weights)


def update(
    particles: Particles,
    predicted: FloatArray,
    process_covariance: FloatArray,
    *,
    measurement: FloatArray,
    measurement_covariance: FloatArray,
    random: np.random.Generator,
) -> tuple[Particles, float]:
    """Return the particles after one step with ``measurement`` = x + noise, (d,), and its log-likelihood.

    ``predicted`` is f(x) of each particle, (N, d). The process covariance may be singular, even zero: m_k
    and Sigma_k (eq. 3.21, 3.22) are taken in the equivalent form with the gain Sigma_eta (Sigma_eta +
    Sigma_nu)^-1. When the measurement is so far off that every weight vanishes, the weights stay as they
    were and the log-likelihood is -inf.
    """
    predictive = process_covariance + measurement_covariance
    innovation = measurement - predicted
    whitened = innovation @ np.linalg.inv(predictive)
    log_likelihood = -0.5 * (
        np.einsum("nd,nd->n", innovation, whitened)
        + np.linalg.slogdet(predictive)[1]
        + measurement.size * np.log(2.0 * np.pi)
    )
    with np.errstate(divide="ignore"):
        log_weights = np.log(particles.weights) + log_likelihood
    weights, log_evidence = normalize_log_weights(log_weights)
    if np.isneginf(log_evidence):
        weights = particles.weights
    gain = np.linalg.solve(predictive, process_covariance).T
    covariance = process_covariance - gain @ process_covariance
    drawn = _gaussian(predicted + innovation @ gain.T, 0.5 * (covariance + covariance.T), random)
    return Particles(drawn, weights), log_evidence


def resample_if_needed(particles: Particles, threshold: float, uniform: float) -> Particles:
    """Return equally weighted particles when N_eff < threshold N, else the same (table 3.1, step 5: 2/3)."""
    count = particles.weights.size
    if effective_sample_size(particles.weights) >= threshold * count:
        return particles
    return Particles(particles.states[systematic(particles.weights, uniform)], np.full(count, 1.0 / count))


def mean_and_covariance(particles: Particles) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean, (d,), and covariance, (d, d), of states that add (no angles).

    Summed without BLAS, whose threads would make the last bits depend on the number of processors.
    """
    mean = np.sum(particles.weights[:, None] * particles.states, axis=0)
    deviation = particles.states - mean
    return mean, np.einsum("ni,nj->ij", particles.weights[:, None] * deviation, deviation)


def _gaussian(means: FloatArray, covariance: FloatArray, random: np.random.Generator) -> FloatArray:
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    drawn: FloatArray = means + random.standard_normal(means.shape) @ root.T
    return drawn
