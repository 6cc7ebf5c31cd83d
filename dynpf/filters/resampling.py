"""Resampling: which particles survive, and when it is time to choose.

All schemes are unbiased: a particle of weight w is taken N w times in the mean. Residual and stratified resampling
never vary more than multinomial (Douc, Cappe and Moulines, 2005); systematic usually varies least.
"""

from typing import Literal, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.filters.cloud import Cloud
from dynpf.portable import whole
from dynpf.rng import Stream
from dynpf.types import Floats, Share

__all__ = ["Indices", "Multinomial", "Resampling", "Residual", "Stratified", "Systematic", "systematic"]

Indices = NDArray[np.int32]


class Resampling(Protocol):
    """What a filter asks of a resampling scheme."""

    def due(self, cloud: Cloud) -> bool:
        """Return whether it is time to resample the cloud."""

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """Return the indices, (count,) and ascending, of the survivors of weights (N,), which need not sum to one.

        Raises ValueError when the weights' sum is not positive and finite.
        """


class _Scheme(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """When survivors are chosen: after every update, or when the effective sample size falls below a share of N."""

    when: Literal["always", "n_eff"] = "n_eff"
    threshold: Share = 0.5  # share of N
    # A robot at rest repeats its readings: choosing among the same particles again only thins them out.
    only_when_moving: bool = False

    def due(self, cloud: Cloud) -> bool:
        """See Resampling."""
        if self.only_when_moving and not cloud.moved:
            return False
        return self.when == "always" or cloud.n_eff < self.threshold * cloud.weights.size


class Systematic(_Scheme, frozen=True, tag="systematic"):
    """One random number places a comb of N equidistant teeth: floor(N w) or ceil(N w) copies (PARTS appendix B)."""

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        return systematic(weights, stream.uniform(), count)


class Stratified(_Scheme, frozen=True, tag="stratified"):
    """One draw in each of N equal strata of the cumulative weights (Kitagawa, 1996)."""

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        return _survivors(weights, (np.arange(count) + stream.fine_uniforms(count)) / max(count, 1))


class Multinomial(_Scheme, frozen=True, tag="multinomial"):
    """Independent draws (Gordon et al., 1993)."""

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        return _survivors(weights, np.sort(stream.fine_uniforms(count)))


class Residual(_Scheme, frozen=True, tag="residual"):
    """The whole copies first, then multinomial draws for what remains (Liu and Chen, 1998)."""

    def select(self, weights: Floats, count: int, stream: Stream) -> Indices:
        """See Resampling."""
        expected = weights.astype(np.float64) * (count / float(_cumulative(weights)[-1]))
        copies = np.floor(expected)
        chosen = np.repeat(np.arange(weights.size, dtype=np.int32), whole(copies, 0, count))[:count]
        missing = count - chosen.size
        if missing == 0:
            return chosen
        drawn = np.sort(stream.fine_uniforms(missing))
        return np.sort(np.append(chosen, _survivors(expected - copies, drawn)))


def systematic(weights: Floats, uniform: float, count: int | None = None) -> Indices:
    """Return the survivors' indices, (count,) (default: N), ascending, for a comb that is placed by ``uniform``.

    ``uniform`` in [0, 1). A particle of weight zero is never taken. Raises ValueError as ``Resampling.select`` does.
    """
    chosen = np.empty(weights.size if count is None else count, dtype=np.int32)
    if weights.dtype != np.float32:
        weights = (weights / _cumulative(weights)[-1]).astype(np.float32)
    if not kernels.cloud.systematic(weights, uniform, chosen):
        raise ValueError(_no_weights(float(np.sum(weights))))
    return chosen


def _survivors(weights: Floats, fractions: NDArray[np.float64]) -> Indices:
    """Return the particles at ascending fractions of the cumulative weights; none of weight zero."""
    cumulative = _cumulative(weights)
    total = cumulative[-1]
    teeth = np.minimum(fractions * total, np.nextafter(total, 0.0))
    survivors: Indices = np.searchsorted(cumulative, teeth, side="right").astype(np.int32, casting="same_kind")
    return survivors


def _cumulative(weights: Floats) -> NDArray[np.float64]:
    cumulative: NDArray[np.float64] = np.cumsum(weights, dtype=np.float64)
    total = float(cumulative[-1]) if weights.size else 0.0
    if not (np.isfinite(total) and total > 0.0):
        raise ValueError(_no_weights(total))
    return cumulative


def _no_weights(total: float) -> str:
    return f"resampling: the weights sum to {total}; a positive finite sum is needed"
