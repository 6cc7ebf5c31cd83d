"""Whether a filter is on its track, unsure, or lost: judged from what it can see of itself.

The judge has no state: what it remembers goes in and out as plain numbers, and the same signs give the same verdict.
"""

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import msgspec

from dynpf.filters.adaptation import log_average, uninformative
from dynpf.params import validated
from dynpf.portable import exp, hypot
from dynpf.types import Count, FloatArray, Positive, Rate, Share

__all__ = ["Figures", "Health", "HealthMemory", "HealthParams", "Signs", "Status", "Verdict"]


class Status(StrEnum):
    """How far the estimate can be relied on."""

    TRACKING = "tracking"
    UNCERTAIN = "uncertain"
    LOST = "lost"
    KIDNAPPED = "kidnapped"  # was on its track, and then explained what it saw from elsewhere on the map alone
    MAP_DOES_NOT_FIT = "map_does_not_fit"  # nowhere on the map explains what is seen


_SEVERITY = (Status.TRACKING, Status.UNCERTAIN, Status.LOST)


class HealthParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits beyond which a filter is unsure or lost, and how long it must stay there to be called so."""

    position_unsure: Positive = 0.5  # m, standard deviation along the direction where it is greatest
    position_lost: Positive = 3.0  # m
    heading_unsure: Positive = 0.35  # rad, standard deviation
    mode_unsure: Share = 0.7  # share of the weight that the heaviest mode must hold
    n_eff_unsure: Share = 0.01  # effective particles as a share of all
    # Likelihood of a reading now, as a share of what it is while on the track: short-term over long-term average.
    likelihood_unsure: Share = 0.6
    likelihood_lost: Share = 0.2
    alpha_slow: Rate = 0.005  # of the way to the newest value, at each update that has readings
    alpha_fast: Rate = 0.1
    # Absolute limit of the short-term average; it depends on the measurement model, so there is none by default.
    log_likelihood_lost: float | None = None  # of one reading, natural logarithm
    refused_unsure: Share = 0.5  # lately, of all readings
    refused_lost: Share = 0.9
    jump_lost: Share = 0.5  # probability that the robot has been set down elsewhere
    unfit_unsure: Count = 3  # searches of the map in a row that find it nowhere
    unheard_lost: Count = 10  # updates in a row that were not taken in; one that is not explained makes unsure, at once
    jumps_unfit: Count = 5  # times that it is found elsewhere without being on its track between
    impossible_lost: Count = 5  # updates in a row that no particle explains; one makes unsure
    worse_after: Count = 3  # assessments in a row that say so
    better_after: Count = 10


class Signs(NamedTuple):
    """The signs of one update, the log-evidence taken before the weights are normalized."""

    covariance: FloatArray  # of the pose, (3, 3)
    n_eff: float
    n: int  # particles
    log_evidence: float  # of all readings that were used, together; NaN if none was
    readings: int  # how many were used: beams, landmarks
    refused: int = 0  # how many were not believed
    modes: tuple[float, ...] | None = None  # masses, the greatest first; None: not looked for
    jump: float = 0.0  # probability that the robot has just been set down where a search of the map has found it
    unfit: int = 0  # searches in a row that found no place which explains the readings
    unexplained: int = 0  # updates in a row that neither the particles nor a slip of the robot explain
    unheard: int = 0  # updates in a row whose readings were so far from being explained that they were not taken in


class HealthMemory(NamedTuple):
    """What a judge remembers: severities are 0 (tracking) to 2 (lost), -1 before the first verdict."""

    severity: int = -1
    candidate: int = -1  # the severity that the last ``run`` assessments agree on, if it is another
    run: int = 0
    log_slow: float = -math.inf  # averages of the likelihood a reading
    log_fast: float = -math.inf
    updates: int = 0  # that the averages are made of
    refused: float = 0.0  # share, averaged at the fast rate
    impossible: int = 0  # in a row
    sound: int = 0  # assessments as tracking since the last jump
    jumps: int = 0  # without having been on the track for long between them
    kidnapped: bool = False  # and not tracking since


class Figures(NamedTuple):
    """The numbers behind a verdict."""

    position_sigma: float  # m, along the direction where it is greatest
    heading_sigma: float  # rad
    mode_mass: float  # of the heaviest mode; NaN where none was looked for
    n_eff_share: float
    log_likelihood: float  # short-term average for one reading; NaN before the first
    likelihood_ratio: float  # short-term over long-term average
    refused_share: float
    impossible: int


class Verdict(NamedTuple):
    """A status, why it is so in words, and the numbers."""

    status: Status
    reason: str
    figures: Figures


class Health:
    """Judges a filter by its spread, modes and weights, and by how well it explains what is sensed.

    The likelihood is the geometric mean over the readings of an update, so that limits do not depend on how many
    there are; its short-term average over the long-term one shows a filter that no longer fits (Thrun et al., 2005,
    section 8.3.3). The long-term average is the mean at first, and only rises while the filter is lost, lest being lost
    become normal. The status changes when several assessments in a row agree, sooner for the worse than for the better.

    Where a search of the map finds the robot elsewhere and most particles go there, it is lost at once: kidnapped, if
    it has been on its track for long enough to tell. A map does not fit on which it is found elsewhere again and again,
    or nowhere while it is lost by other figures; by itself, being nowhere explained as usual makes unsure.
    """

    def __init__(self, params: HealthParams | None = None) -> None:
        self.params = validated(HealthParams() if params is None else params)

    def begin(self) -> HealthMemory:
        """Return the memory of nothing: the first verdict is that of the first signs."""
        return HealthMemory()

    def assess(self, memory: HealthMemory, signs: Signs) -> tuple[HealthMemory, Verdict]:
        """Return the memory after an update, and the verdict."""
        memory = self._taken_in(memory, signs)
        if signs.jump > self.params.jump_lost:
            memory = self._jumped(memory)
        figures = _figures(memory, signs)
        findings = [*self._findings(figures), *self._found_by_search(signs)]
        severity = max((found for found, _ in findings), default=0)
        memory = self._settled(memory, severity)
        if signs.unexplained > 0 and memory.severity == 0:
            memory = memory._replace(severity=1, candidate=1, run=0)
        on_track = memory.severity == 0
        memory = memory._replace(sound=memory.sound + on_track, kidnapped=memory.kidnapped and memory.severity == 2)
        texts = [text for found, text in findings if found == severity] or ["all figures are within their limits"]
        reason = "; ".join(texts)
        if severity != memory.severity:
            needed = self.params.worse_after if severity > memory.severity else self.params.better_after
            reason += f" ({_SEVERITY[severity]} in {memory.run} of {needed} assessments)"
        return memory, Verdict(self._status(memory, signs), reason, figures)

    def _status(self, memory: HealthMemory, signs: Signs) -> Status:
        if memory.severity < 2:
            return _SEVERITY[memory.severity]
        if memory.jumps >= self.params.jumps_unfit or signs.unfit >= self.params.unfit_unsure:
            return Status.MAP_DOES_NOT_FIT
        return Status.KIDNAPPED if memory.kidnapped else Status.LOST

    def _jumped(self, memory: HealthMemory) -> HealthMemory:
        """Return the memory after most particles went elsewhere: lost, at once, and judged by what they see there."""
        sound = memory.sound >= self.params.better_after
        memory = memory._replace(jumps=1 if sound else memory.jumps + 1, kidnapped=memory.kidnapped or sound, sound=0)
        return memory._replace(severity=2, candidate=2, run=0, log_fast=memory.log_slow, impossible=0)

    def _found_by_search(self, signs: Signs) -> Iterator[tuple[int, str]]:
        if signs.jump > self.params.jump_lost:
            yield 2, f"found elsewhere on the map, with probability {signs.jump:.3g}"
        if signs.unexplained > 0:
            yield 1, f"neither the track nor a slip explains the last {signs.unexplained} updates"
        if signs.unheard >= self.params.unheard_lost:
            yield 2, f"the last {signs.unheard} updates are of nothing on the map here: by odometry alone"
        if signs.unfit >= self.params.unfit_unsure:
            yield 1, f"the last {signs.unfit} searches found no place on the map that explains what is seen as usual"

    def _taken_in(self, memory: HealthMemory, signs: Signs) -> HealthMemory:
        """Return the memory with the update's likelihood and refused readings averaged in."""
        params = self.params
        seen = signs.readings + signs.refused
        if seen > 0:
            share = signs.refused / seen
            memory = memory._replace(refused=memory.refused + params.alpha_fast * (share - memory.refused))
        if uninformative(signs.log_evidence, signs.readings):
            return memory
        log_mean = signs.log_evidence / signs.readings
        impossible = memory.impossible + 1 if log_mean == -math.inf else 0
        updates = memory.updates + 1
        slow, fast = (memory.log_slow, memory.log_fast) if memory.updates else (log_mean, log_mean)
        if memory.severity != 2 or log_mean > slow:
            slow = log_average(slow, log_mean, max(params.alpha_slow, 1.0 / updates))
        fast = log_average(fast, log_mean, params.alpha_fast)
        return memory._replace(log_slow=slow, log_fast=fast, updates=updates, impossible=impossible)

    def _findings(self, figures: Figures) -> Iterator[tuple[int, str]]:
        """Yield the severity and the text of each figure that is beyond a limit."""
        params = self.params
        sigma, heading = figures.position_sigma, figures.heading_sigma
        yield from _above("position spread", sigma, params.position_unsure, params.position_lost, " m")
        yield from _above("heading spread", heading, params.heading_unsure, math.inf, " rad")
        refused = figures.refused_share
        yield from _above("share of refused readings", refused, params.refused_unsure, params.refused_lost)
        ratio = figures.likelihood_ratio
        yield from _below("likelihood to its average", ratio, params.likelihood_unsure, params.likelihood_lost)
        yield from _below("share of the heaviest mode", figures.mode_mass, params.mode_unsure)
        yield from _below("effective share of particles", figures.n_eff_share, params.n_eff_unsure)
        if params.log_likelihood_lost is not None:
            floor = params.log_likelihood_lost
            yield from _below("log-likelihood of a reading", figures.log_likelihood, floor, floor)
        if figures.impossible > 0:
            severity = 2 if figures.impossible >= params.impossible_lost else 1
            yield severity, f"no particle explains the last {figures.impossible} updates"

    def _settled(self, memory: HealthMemory, severity: int) -> HealthMemory:
        """Return the memory after an assessment: its severity changes to what a long enough run agrees on.

        A run goes on while assessments are on the same side of the status, and agrees on the nearest of them.
        """
        current = memory.severity
        if current < 0 or severity == current:
            return memory._replace(severity=severity, candidate=severity, run=0)
        worse = severity > current
        if memory.run > 0 and (memory.candidate > current) == worse:
            candidate = min(severity, memory.candidate) if worse else max(severity, memory.candidate)
            run = memory.run + 1
        else:
            candidate, run = severity, 1
        if run >= (self.params.worse_after if worse else self.params.better_after):
            return memory._replace(severity=candidate, candidate=candidate, run=0)
        return memory._replace(candidate=candidate, run=run)


def _figures(memory: HealthMemory, signs: Signs) -> Figures:
    xx, xy, yy = (float(signs.covariance[index]) for index in ((0, 0), (0, 1), (1, 1)))
    # The larger eigenvalue of the covariance of the position.
    variance = 0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy)
    known = memory.updates > 0 and memory.log_slow > -math.inf
    return Figures(
        position_sigma=math.sqrt(max(variance, 0.0)),
        heading_sigma=math.sqrt(max(float(signs.covariance[2, 2]), 0.0)),
        mode_mass=math.nan if signs.modes is None else max(signs.modes, default=0.0),
        n_eff_share=signs.n_eff / signs.n,
        log_likelihood=memory.log_fast if memory.updates else math.nan,
        likelihood_ratio=exp(min(memory.log_fast - memory.log_slow, 700.0)) if known else math.nan,
        refused_share=memory.refused,
        impossible=memory.impossible,
    )


def _above(what: str, value: float, unsure: float, lost: float, unit: str = "") -> Iterator[tuple[int, str]]:
    # Written so that a value that is not a number is beyond every limit.
    if not value <= lost:
        yield 2, f"{what} {value:.3g}{unit} above {lost:.3g}{unit}"
    elif not value <= unsure:
        yield 1, f"{what} {value:.3g}{unit} above {unsure:.3g}{unit}"


def _below(what: str, value: float, unsure: float, lost: float = -math.inf) -> Iterator[tuple[int, str]]:
    # Nothing is known of a value that is not a number: it is below no limit.
    if value < lost:
        yield 2, f"{what} {value:.3g} below {lost:.3g}"
    elif value < unsure:
        yield 1, f"{what} {value:.3g} below {unsure:.3g}"
