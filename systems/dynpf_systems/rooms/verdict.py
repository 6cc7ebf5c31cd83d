"""What became of a robot's localization, in words: when it was on its track, when it was lost, and whether that is so.

What the filter says of itself is held against the walls that its scans should meet, and against the reference, if the
log has one.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from dynpf_experiments.messages import RunMessages, of_type
from dynpf_experiments.pictures.estimates import shares
from dynpf_protocol.messages import Estimate

from dynpf.filters.health import Status
from dynpf_systems.rooms.measures import LOST_M

__all__ = ["Fit", "Span", "Verdict", "spans_of", "verdict_of"]

LOST = (Status.LOST, Status.KIDNAPPED, Status.MAP_DOES_NOT_FIT)
BETTER_THAN_CHANCE = 0.15
"""By how much more of the beams must end near walls at the estimate than anywhere, to be believed."""

WRONG_SHARE = 0.05
"""Share of the estimates that may be wrong, and called tracking, in a run that is called localized."""

LEAST_TRACKING = 0.25
"""Share of the time on the track in a run that is called localized though it does not end there."""

SHOWN = 3


class Fit(NamedTuple):
    """Shares of beams that end near a wall: at the estimates, at the reference's poses, and by chance; or NaN."""

    estimate: float = math.nan
    reference: float = math.nan
    chance: float = math.nan


class Span(NamedTuple):
    """A time in which the health status stays the same, from the first record on, s, and the first reason given."""

    status: str
    start_s: float
    end_s: float
    reason: str


class Verdict(NamedTuple):
    """Whether the robot was localized, why, in a sentence, and the share of the time in each status."""

    localized: bool
    text: str
    shares: dict[str, float]
    spans: list[Span]


def spans_of(run: RunMessages, topic: str = "estimator/state") -> list[Span]:
    """Return the times of equal health status of an estimator, in order; estimates without health are in none."""
    timed = run.topic(topic)
    estimates = of_type(timed, Estimate)
    spans: list[Span] = []
    start_ns = timed[0].stamp_ns if timed else 0
    for message, estimate in zip(timed, estimates, strict=True):
        health = estimate.health
        if not health:
            continue
        at_s = (message.stamp_ns - start_ns) * 1e-9
        if spans:
            spans[-1] = spans[-1]._replace(end_s=at_s)
        if not spans or spans[-1].status != health.status:
            spans.append(Span(health.status, at_s, at_s, health.reason))
    return spans


def verdict_of(spans: list[Span], wrong: float, fit: Fit) -> Verdict:
    """Return the verdict.

    ``wrong`` is the share of the estimates that are wrong while the filter says that it is on its track; where the
    reference is in another frame than the map, after alignment.
    """
    of_time = shares((span.status, span.end_s - span.start_s) for span in spans)
    tracking = of_time.get(Status.TRACKING, 0.0)
    told = _told(of_time)
    contradiction = _contradiction(wrong, fit)
    if not spans:
        return Verdict(False, "not localized: there is no estimate", of_time, spans)
    last = spans[-1]
    if last.status in LOST:
        before = f" (before that {told})" if len(spans) > 1 else ""
        text = f"{_in_words(last.status)} from {_since(spans):.1f} s on, to the end: {last.reason}{before}"
        return Verdict(False, text, of_time, spans)
    if contradiction:
        return Verdict(False, f"not localized, whatever the filter says ({told}): {contradiction}", of_time, spans)
    if tracking < LEAST_TRACKING and last.status != Status.TRACKING:
        return Verdict(False, f"not localized for long: {told}", of_time, spans)
    text = f"localized: {told}{_lost_in(spans)}"
    return Verdict(True, text, of_time, spans)


def _told(shares: Mapping[str, float]) -> str:
    """Return the shares in words: 94 % of the time tracking, 6 % uncertain."""
    parts = [f"{100.0 * share:.0f} % {{}}{status.replace('_', ' ')}" for status, share in shares.items()]
    return ", ".join(part.format("" if index else "of the time ") for index, part in enumerate(parts))


def _since(spans: list[Span]) -> float:
    """Return since when the filter has been lost without being on its track between."""
    since = spans[-1].start_s
    for span in reversed(spans):
        if span.status == Status.TRACKING:
            break
        since = span.start_s if span.status in LOST else since
    return since


def _lost_in(spans: list[Span]) -> str:
    lost = [span for span in spans if span.status in LOST]
    if not lost:
        return ""
    longest = sorted(sorted(lost, key=lambda span: span.start_s - span.end_s)[:SHOWN])
    longest.sort(key=lambda span: span.start_s)
    told = "; ".join(f"{_in_words(span.status)} from {span.start_s:.1f} to {span.end_s:.1f} s" for span in longest)
    more = f", and {len(lost) - SHOWN} times more" if len(lost) > SHOWN else ""
    return f"; {told}{more}"


def _in_words(status: str) -> str:
    return "the map does not fit" if status == Status.MAP_DOES_NOT_FIT else status


def _contradiction(wrong: float, fit: Fit) -> str:
    """Return what speaks against a filter that says it is on its track, or an empty text."""
    if fit.estimate < fit.chance + BETTER_THAN_CHANCE:
        return (
            f"{100.0 * fit.estimate:.0f} % of the beams end near a wall at its estimates, {100.0 * fit.chance:.0f} % "
            "would anywhere on the map"
        )
    if wrong > WRONG_SHARE:
        return f"in {100.0 * wrong:.0f} % of the time it says tracking, more than {LOST_M:g} m from the reference"
    return ""
