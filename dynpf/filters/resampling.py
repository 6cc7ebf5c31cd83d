"""Resampling: which particles survive, and when it is time to choose.

All schemes are unbiased: a particle of weight w is taken N w times in the mean. Residual and stratified resampling never
vary more than multinomial (Douc, Cappe and Moulines, 2005); systematic usually varies least.
"""

from typing import Annotated, Literal, Protocol

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.filters.cloud import Cloud
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.se2 import Floats

__all__ = [
    "Indices",
    "Multinomial",
    "MultinomialParams",
    "Resampling",
    "ResamplingParams",
    "Residual",
    "ResidualParams",
    "Stratified",
    "StratifiedParams",
    "Systematic",
    "SystematicParams",
    "resampling_is_due",
    "systematic",
]

Indices = NDArray[np.int32]


class ResamplingParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """When survivors are chosen: after every update, or when the effective sample size falls below a share of N."""

    when: Literal["always", "n_eff"] = "n_eff"
    threshold: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.5  # share of N
    # A robot at rest repeats its readings: choosing among the same particles again only thins them out.
    only_when_moving: bool = False


class MultinomialParams(ResamplingParams, tag="multinomial"):
    """Independent draws."""


class StratifiedParams(ResamplingParams, tag="stratified"):
    """One draw in each of N equal strata of the cumulative weights."""


class ResidualParams(ResamplingParams, tag="residual"):
    """The whole copies first, and multinomial draws for what remains."""


class SystematicParams(ResamplingParams, tag="systematic"):
    """One random number places a comb of N equidistant teeth on the cumulative weights."""


class Resampling(Protocol):
    """A scheme: its parameters, and a choice of survivors."""

    @property
    def params(self) -> ResamplingParams:
        """When survivors are chosen."""

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """Return the indices, (count,) and ascending, of the survivors of weights (N,), which need not sum to one.

        Raises ValueError when the weights' sum is not positive and finite.
        """


def resampling_is_due(params: ResamplingParams, cloud: Cloud) -> bool:
    """Return whether it is time to resample the cloud."""
    if params.only_when_moving and not cloud.moved:
        return False
    return params.when == "always" or cloud.n_eff < params.threshold * cloud.weights.size


class Systematic:
    """Systematic resampling (PARTS appendix B): floor(N w) or ceil(N w) copies."""

    def __init__(self, params: SystematicParams = SystematicParams()) -> None:
        self.params = validated(params)

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        return systematic(weights, stream.uniform(), count)


class Stratified:
    """Stratified resampling."""

    def __init__(self, params: StratifiedParams = StratifiedParams()) -> None:
        self.params = validated(params)

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        return _survivors(weights, (np.arange(count) + stream.fine_uniforms(count)) / max(count, 1))


class Multinomial:
    """Multinomial resampling."""

    def __init__(self, params: MultinomialParams = MultinomialParams()) -> None:
        self.params = validated(params)

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        return _survivors(weights, np.sort(stream.fine_uniforms(count)))


class Residual:
    """Residual resampling (Liu and Chen, 1998)."""

    def __init__(self, params: ResidualParams = ResidualParams()) -> None:
        self.params = validated(params)

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        total = float(_cumulative(weights)[-1])
        expected = weights.astype(np.float64) * (count / total)
        whole = np.floor(expected)
        chosen = np.repeat(np.arange(weights.size, dtype=np.int32), whole.astype(np.intp))[:count]
        missing = count - chosen.size
        if missing == 0:
            return chosen
        return np.sort(np.append(chosen, _survivors(expected - whole, np.sort(stream.fine_uniforms(missing)))))


def systematic(weights: Floats, uniform: float, count: int | None = None) -> Indices:
    """Return the survivors' indices, (count,) (default: N), ascending, for a comb that is placed by ``uniform``.

    ``uniform`` in [0, 1). A particle of weight zero is never taken. Raises ValueError as ``Resampling.select`` does.
    """
    chosen = np.empty(weights.size if count is None else count, dtype=np.int32)
    if not kernels.cloud.systematic(np.asarray(weights, dtype=np.float32), uniform, chosen):
        raise ValueError(_no_weights(float(np.sum(weights))))
    return chosen


def _survivors(weights: Floats, fractions: NDArray[np.float64]) -> Indices:
    """Return the particles at ascending fractions of the cumulative weights; none of weight zero."""
    cumulative = _cumulative(weights)
    total = cumulative[-1]
    teeth = np.minimum(fractions * total, np.nextafter(total, 0.0))
    return np.searchsorted(cumulative, teeth, side="right").astype(np.int32)


def _cumulative(weights: Floats) -> NDArray[np.float64]:
    cumulative: NDArray[np.float64] = np.cumsum(weights, dtype=np.float64)
    total = float(cumulative[-1]) if weights.size else 0.0
    if not (np.isfinite(total) and total > 0.0):
        raise ValueError(_no_weights(total))
    return cumulative


def _no_weights(total: float) -> str:
    return f"resampling: the weights sum to {total}; a positive finite sum is needed"
