"""Where a filter looks for the next state: the densities that particles are drawn from."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, cast

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.filters.cloud import Cloud, gathered, normalized_weights
from dynpf.filters.models import Evidence, Models, Outcome
from dynpf.filters.resampling import Indices, systematic
from dynpf.filters.shapes import shaped
from dynpf.measurement.model import GaussianMeasurement
from dynpf.motion.model import GaussianMotion
from dynpf.portable import inverse, log, log_determinant
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats

__all__ = [
    "Auxiliary",
    "LocalLinearization",
    "Optimal",
    "Prior",
    "Proposal",
    "Proposed",
]


class Proposed(NamedTuple):
    """New particles (D, N), their log-weights (N,), and what became of each reading.

    The log-weights are not normalized: the sum of their exponentials estimates p(readings | all before them). They
    are None where no reading weighs. ``ancestors`` (N,) are the particles that these come from, None for themselves.
    """

    particles: Floats
    log_weights: Floats | None
    outcomes: list[Outcome]
    readings: int = 0  # that the log-weights speak of, each of a batch by itself
    ancestors: Indices | None = None


class Proposal(Protocol):
    """Draws the next particles, given the control and the readings at its end."""

    def propose(self, models: Models, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> Proposed:
        """Return the proposed particles and their log-weights; a control of None means that nothing moved."""


class Prior(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="prior"):
    """The motion model itself: sampling importance resampling, or bootstrap filter (Gordon et al., 1993).

    Particles move and are weighed by the likelihood; any models will do.
    """

    def propose(self, models: Models, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> Proposed:
        """See Proposal."""
        particles = cloud.particles
        if control is not None:
            particles = models.propagate(particles, control, stream.part("motion"))
        if not readings:
            return Proposed(particles, None, [])
        evidence, outcomes = models.believable(particles, cloud.weights, readings)
        if not evidence:
            return Proposed(particles, None, outcomes)
        return Proposed(
            particles, cloud.log_weights + models.log_likelihood(particles, evidence), outcomes, _count(evidence)
        )


class Auxiliary(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="auxiliary"):
    """The auxiliary particle filter: survivors are chosen by what the readings will say (Pitt and Shephard, 1999).

    Each particle is judged by where the motion is expected to take it; the survivors then move, and are weighed by how
    much better or worse they came out than was expected. Needs a motion model with ``expected``.
    """

    def propose(self, models: Models, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> Proposed:
        """See Proposal."""
        if control is None or not readings:
            return Prior().propose(models, cloud, control, readings, stream)
        motion = cast(GaussianMotion[Any], models.motion)
        _require(motion, ("expected",), self)
        expected = motion.expected(cloud.particles, control)
        evidence, outcomes = models.believable(expected, cloud.weights, readings)
        if not evidence:
            return Proposed(models.propagate(cloud.particles, control, stream.part("motion")), None, outcomes)
        promise = models.log_likelihood(expected, evidence)
        first_stage, log_sum = normalized_weights(cloud.log_weights + promise)
        if log_sum == -np.inf:
            return Prior().propose(models, cloud, control, readings, stream)
        ancestors = systematic(first_stage, stream.part("ancestors").uniform())
        particles = models.propagate(gathered(cloud.particles, ancestors), control, stream.part("motion"))
        surprise = models.log_likelihood(particles, evidence) - promise[ancestors]
        return Proposed(
            particles, surprise + (log_sum - log(float(ancestors.size))), outcomes, _count(evidence), ancestors
        )


class Optimal(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="optimal"):
    """p(x | particle, readings), which keeps the weights' variance least (PARTS eq. 3.18 to 3.23).

    Exact for Gaussian noise and readings linear in the state. Needs a GaussianMotion and GaussianMeasurement models.
    A particle is weighed by p(readings | particle), whatever was drawn from it.
    """

    def propose(self, models: Models, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> Proposed:
        """See Proposal."""
        guided = _guide(models, cloud, control, readings, stream, needed_by=self)
        if isinstance(guided, Proposed):
            return guided
        # log N(z; h, H Q H^T + R), by the determinant lemma on the posterior of the noise.
        log_predictive = guided.log_density_at_mean + 0.5 * guided.mahalanobis_gain - guided.log_root_determinant
        return Proposed(guided.drawn, cloud.log_weights + log_predictive, guided.outcomes, _count(guided.evidence))


class LocalLinearization(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="local_linearization"
):
    """The same Gaussian with readings linearized at each particle's expectation (Doucet et al., 2000, II.D).

    The weights make up for what the linearization misses: the likelihood in them is the models' own, outliers and
    tempering included. Needs a GaussianMotion and GaussianMeasurement models.
    """

    def propose(self, models: Models, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> Proposed:
        """See Proposal."""
        guided = _guide(models, cloud, control, readings, stream, needed_by=self)
        if isinstance(guided, Proposed):
            return guided
        likelihood = models.log_likelihood(guided.drawn, guided.evidence)
        log_weights = cloud.log_weights + likelihood + guided.log_prior_over_proposal
        return Proposed(guided.drawn, log_weights, guided.outcomes, _count(guided.evidence))


class _Guided(NamedTuple):
    """Draws from the Gaussian that the readings leave of the motion's noise, and terms of the weights, each (N,)."""

    drawn: Floats
    evidence: list[Evidence]
    outcomes: list[Outcome]
    log_density_at_mean: FloatArray  # log N(z; h(f(x)), R)
    mahalanobis_gain: FloatArray  # b^T P^-1 b
    log_root_determinant: FloatArray  # 0.5 log det P
    log_prior_over_proposal: FloatArray


def _guide(
    models: Models, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream, *, needed_by: Proposal
) -> "_Guided | Proposed":
    """Draw from the Gaussian of the noise given the readings; without readings or motion, propose as the prior does.

    The state is f + L e with e standard normal and L L^T = Q, so that a singular Q needs no inverse. To first order a
    reading is z = h(f) + H L e + v: the posterior of e has precision P = I + A^T R^-1 A, A = H L, and mean P^-1 b,
    b = A^T R^-1 (z - h(f)).
    """
    if control is None or not readings:
        return Prior().propose(models, cloud, control, readings, stream)
    motion = cast(GaussianMotion[Any], models.motion)
    _require(motion, ("expected", "covariance"), needed_by)
    size, count = cloud.particles.shape
    expected = shaped("the states that a motion expects", motion.expected(cloud.particles, control), size, count)
    evidence, outcomes = models.believable(expected, cloud.weights, readings)
    if not evidence:
        return Proposed(models.propagate(cloud.particles, control, stream.part("motion")), None, outcomes)
    process = shaped("a motion's covariance", motion.covariance(cloud.particles, control), size, size, count)
    root = np.empty((size, size, count))
    kernels.proposal.roots(process, root)
    precision = np.zeros((size, size, count))
    precision[np.arange(size), np.arange(size)] = 1.0
    pull, log_density = np.zeros((size, count)), np.zeros(count)
    for model, reading, _ in evidence:
        _require(model, ("innovation", "jacobian", "noise"), needed_by)
        gaussian = cast(GaussianMeasurement[Any], model)
        noise = np.asarray(gaussian.noise(reading), dtype=np.float64)
        rows, log_peak = len(noise), -0.5 * log_determinant(2.0 * math.pi * noise)
        slopes = shaped("a Jacobian", gaussian.jacobian(expected, reading), rows, size, count)
        innovation = shaped("an innovation", gaussian.innovation(expected, reading), rows, count)
        kernels.proposal.add_reading(root, slopes, innovation, inverse(noise), log_peak, precision, pull, log_density)
    standard = stream.part("motion").normals(size, count)
    drawn, (gain, log_root_determinant, log_ratio) = np.empty((size, count)), np.empty((3, count))
    kernels.proposal.draw(expected, root, precision, pull, standard, drawn, gain, log_root_determinant, log_ratio)
    return _Guided(
        np.ascontiguousarray(drawn, dtype=cloud.particles.dtype),
        evidence,
        outcomes,
        log_density,
        gain,
        log_root_determinant,
        log_ratio,
    )


def _count(evidence: Sequence[Evidence]) -> int:
    return sum(int(each.readings) for each in evidence)


def _require(model: object, methods: tuple[str, ...], proposal: Proposal) -> None:
    missing = [name for name in methods if not hasattr(model, name)]
    if missing:
        lack = " and no ".join(missing)
        raise TypeError(f"{type(proposal).__name__} needs a Gaussian model; {type(model).__name__} has no {lack}")
