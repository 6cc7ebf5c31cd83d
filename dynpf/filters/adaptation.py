"""How a filter changes its own size, and how it finds back when it is lost."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from msgspec import Meta

from dynpf import kernels
from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import turn_bins
from dynpf.params import validated
from dynpf.portable import exp, log, log1p, logaddexp, normal_quantile
from dynpf.rng import Stream
from dynpf.types import Count, Floats, Positive, Rate, Share

if TYPE_CHECKING:
    from dynpf.filters.models import Models
    from dynpf.filters.search import Places

__all__ = [
    "Augmented",
    "AugmentedParams",
    "Doubt",
    "Following",
    "Kld",
    "KldParams",
    "PoseSource",
    "Recovery",
    "Rescue",
    "Rescuer",
    "SensorResetting",
    "SensorResettingParams",
    "Sizing",
    "kld_bound",
    "log_average",
    "uninformative",
]

CellM = Annotated[float, Meta(ge=1e-3)]


class Sizing(Protocol):
    """How many particles a filter goes on with; without one it keeps as many as it has."""

    def size(self, particles: Floats, weights: Floats) -> int:
        """Return how many are to be drawn at the resampling of particles (D, N) under weights (N,)."""


class KldParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="kld"):
    """With this probability the particles' distribution over the cells is within epsilon of the true one."""

    epsilon: Positive = 0.05  # Kullback-Leibler divergence, nats
    probability: Annotated[float, Meta(gt=0.5, lt=1.0)] = 0.99
    cell_x: CellM = 0.5  # m
    cell_y: CellM = 0.5  # m
    cell_heading: Annotated[float, Meta(ge=1e-3)] = math.radians(10.0)  # rad, rounded: a whole number makes the circle
    n_min: Count = 100
    n_max: Count = 100_000

    def __post_init__(self) -> None:
        if self.n_min > self.n_max:
            raise ValueError(f"n_min = {self.n_min} is above n_max = {self.n_max}")


class Kld:
    """KLD-sampling (Fox, 2001; 2003): as many particles as the number of cells that they occupy calls for.

    Fox counts cells while he draws one survivor after another, and stops when there are enough. Here the cells are
    those of the survivors that a systematic comb of all N particles would leave: the count does not depend on chance,
    is never below Fox's for the same particles, and reaches his from above within an update or two.
    """

    def __init__(self, params: KldParams) -> None:
        self.params = validated(params)
        self.turn_bins = turn_bins(params.cell_heading)
        self.quantile = normal_quantile(params.probability)

    def size(self, particles: Floats, weights: Floats) -> int:
        """See Sizing. Particles that are not finite are in no cell."""
        params = self.params
        cells = self.cells(particles, weights)
        bound = kld_bound(cells, params.epsilon, self.quantile)
        return min(max(math.ceil(bound), params.n_min), params.n_max)

    def cells(self, particles: Floats, weights: Floats) -> int:
        """Return how many cells the survivors occupy."""
        x, y, theta = np.ascontiguousarray(particles[:3], dtype=np.float32)
        per_x, per_y = 1.0 / self.params.cell_x, 1.0 / self.params.cell_y
        weights = np.asarray(weights, dtype=np.float32)
        return int(kernels.bins.occupied(x, y, theta, weights, per_x, per_y, self.turn_bins))


def kld_bound(cells: int, epsilon: float, quantile: float) -> float:
    """Return the number of draws for a divergence below ``epsilon`` over so many occupied cells (Fox, 2003, eq. 7).

    That is the chi-square quantile of cells - 1 degrees of freedom over 2 epsilon, by Wilson and Hilferty's
    approximation, of which ``quantile`` is the normal one. One cell has no divergence: 0.
    """
    if cells <= 1:
        return 0.0
    freedom = cells - 1.0
    spread = 2.0 / (9.0 * freedom)
    side = 1.0 - spread + math.sqrt(spread) * quantile
    return freedom / (2.0 * epsilon) * (side * side * side)


class Recovery(Protocol):
    """When a filter is to doubt all of its particles. What it remembers is data, not its own: it goes in and out."""

    def begin(self) -> tuple[float, ...]:
        """Return the memory of having seen nothing."""

    def assess(
        self, memory: tuple[float, ...], log_evidence: float, readings: int = 1
    ) -> tuple[tuple[float, ...], float]:
        """Return the memory after an update, and the share of particles to replace at the next resampling.

        ``log_evidence`` is the log of the particles' mean likelihood before normalization, for ``readings`` readings
        together. It counts as so many equal ones: their geometric mean does not depend on how many there are. A NaN,
        +inf, or no readings carry no information: memory stays as it was and the share is 0.
        """


class AugmentedParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="augmented"
):
    """Rates of the two averages, a share of the way to the newest value at each update."""

    alpha_slow: Rate = 0.001
    alpha_fast: Rate = 0.1
    share_max: Share = 1.0  # of the particles, replaced at once

    def __post_init__(self) -> None:
        if self.alpha_slow >= self.alpha_fast:
            raise ValueError(f"alpha_slow = {self.alpha_slow} is not below alpha_fast = {self.alpha_fast}")


class Augmented:
    """Augmented Monte Carlo localization (Thrun et al., 2005, table 8.3).

    The share is 1 - w_fast / w_slow, or 0: how far the likelihood has lately fallen below what it used to be. The
    averages are kept as logarithms, for likelihoods underflow, and begin at the first value. Where no likelihood has
    ever been above zero, the share is the greatest.
    """

    def __init__(self, params: AugmentedParams) -> None:
        self.params = validated(params)

    def begin(self) -> tuple[float, ...]:
        """Return no averages."""
        return ()

    def assess(
        self, memory: tuple[float, ...], log_evidence: float, readings: int = 1
    ) -> tuple[tuple[float, ...], float]:
        """See Recovery; the memory is (log w_slow, log w_fast)."""
        if uninformative(log_evidence, readings):
            return memory, 0.0
        log_mean = log_evidence / readings
        slow, fast = memory or (log_mean, log_mean)
        slow = log_average(slow, log_mean, self.params.alpha_slow)
        fast = log_average(fast, log_mean, self.params.alpha_fast)
        share = 1.0 if slow == -math.inf else 1.0 - exp(min(fast - slow, 0.0))
        return (slow, fast), min(share, self.params.share_max)


class SensorResettingParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="sensor_resetting"
):
    """The likelihood that a filter on its track should see; it depends on the measurement model and its units."""

    log_likelihood: float  # of one reading, natural logarithm; a density's may be above 0
    share_max: Share = 1.0  # of the particles, replaced at once


class SensorResetting:
    """Sensor resetting (Lenser and Veloso, 2000): the share is 1 - w / threshold, or 0, by the newest readings."""

    def __init__(self, params: SensorResettingParams) -> None:
        self.params = validated(params)

    def begin(self) -> tuple[float, ...]:
        """Return nothing: there is nothing to remember."""
        return ()

    def assess(
        self, memory: tuple[float, ...], log_evidence: float, readings: int = 1
    ) -> tuple[tuple[float, ...], float]:
        """See Recovery."""
        if uninformative(log_evidence, readings):
            return memory, 0.0
        short = min(log_evidence / readings - self.params.log_likelihood, 0.0)
        return memory, min(1.0 - exp(short), self.params.share_max)


def uninformative(log_evidence: float, readings: int) -> bool:
    """Return whether there was no reading, or its likelihood is no number."""
    return readings < 1 or math.isnan(log_evidence) or log_evidence == math.inf


def log_average(log_average: float, log_value: float, rate: float) -> float:
    """Return log((1 - rate) average + rate value), of logarithms that may be -inf."""
    average: float = logaddexp(float(log_average + log1p(-rate)), float(log_value + log(rate)))
    return average


class PoseSource(Protocol):
    """Where particles come from that replace doubted ones."""

    def draw(self, count: int, readings: Sequence[Any], stream: Stream) -> Floats:
        """Return poses (3, count) float32, given the readings of the moment; there may be none."""


class Doubt(NamedTuple):
    """How far a filter is to doubt its particles: what it remembers, the share to replace, and from where.

    ``places`` are those that a search of the map has found, if there was one; ``unfit`` is how many searches in a row
    have found nowhere that explains the readings as usual. ``jumped`` is how likely it is that the robot has just been
    set down elsewhere, as far as the rescue can tell. ``unexplained`` counts updates in a row that neither the
    particles nor a slip explain, and ``unheard`` those of them that are not to be taken in. Where it is ``settled``
    that the robot is at the places, the estimate is that of the particles drawn there.
    """

    memory: tuple[float, ...]
    share: float
    source: PoseSource
    places: "Places | None" = None
    unfit: int = 0
    jumped: float = 0.0
    unexplained: int = 0
    unheard: int = 0
    settled: bool = False


class Rescuer(Protocol):
    """How a lost filter finds back: when to replace particles, and from where."""

    def begin(self) -> tuple[float, ...]:
        """Return the memory of having seen nothing."""

    def doubt(self, cloud: Cloud, log_evidence: float, count: int, readings: Sequence[Any]) -> Doubt:
        """Return the doubt of a weighted cloud after an update by so many readings, which ``readings`` hold.

        See Recovery.assess; what is remembered is in the cloud's memory.
        """


@runtime_checkable
class Following(Protocol):
    """A rescuer whose memory holds poses, which move with the robot.

    It is asked about the cloud that the readings met: moved, under the weights before them, but for its n_eff.
    """

    def carried(self, memory: tuple[float, ...], models: "Models", control: Any) -> tuple[float, ...]:
        """Return the memory after a control."""


class Rescue(NamedTuple):
    """Doubt by the likelihood alone; particles that replace others come from the source."""

    recovery: Recovery
    source: PoseSource

    def begin(self) -> tuple[float, ...]:
        """See Rescuer."""
        return self.recovery.begin()

    def doubt(
        self,
        cloud: Cloud,
        log_evidence: float,
        count: int,
        readings: Sequence[Any],  # noqa: ARG002
    ) -> Doubt:
        """See Rescuer."""
        memory, share = self.recovery.assess(cloud.memory, log_evidence, count)
        return Doubt(memory, share, self.source)
