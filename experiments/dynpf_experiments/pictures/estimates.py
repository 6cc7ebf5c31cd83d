"""The estimates of a run: path, covariance, particles' effective number, health, and errors against the truth."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from dynpf_protocol.messages import Estimate, FilterHealth, HealthFigures
from numpy.typing import NDArray

from dynpf.metrics.trajectory import Trajectory, pose_errors
from dynpf.types import FloatArray
from dynpf_experiments.pictures.changes import changed
from dynpf_experiments.pictures.drawing import Line, Plot, Track
from dynpf_experiments.pictures.source import RunSource, robot_of
from dynpf_experiments.pictures.tracks import columns_of

__all__ = ["Estimated", "Span", "error_plots", "estimates_of", "filter_plots", "position_errors", "shares", "verdicts"]

STATE = "/state"
MAX_GAP_S = 0.5
"""The truth is interpolated over no longer gaps; one that is sparser is compared at its own stamps."""

CHI_SQUARE_2 = (0.0506, 7.378)
"""Between these lie 95 % of the squared position errors of an honest filter: quantiles of chi-square, 2 degrees."""

MOST_SPANS = 400


class Estimated(NamedTuple):
    """The estimates of a node: their path, effective sample sizes (T,), and health, None where it is not monitored."""

    track: Track
    n_eff: FloatArray
    health: list[FilterHealth | None]


class Span(NamedTuple):
    """A verdict of a filter on itself, from ``begin`` until ``end``, s; ``reason`` is the first that it gave.

    ``changed`` says in words which of its figures are no longer what they were in the verdict before.
    """

    begin: float
    end: float
    status: str
    reason: str
    changed: str = ""


def estimates_of(source: RunSource) -> list[Estimated]:
    """Return the estimates of all nodes."""
    found = []
    for topic in source.carrying(Estimate):
        if topic.endswith(STATE):
            known = [(at, m) for at, m in source.messages(topic) if isinstance(m, Estimate)]
            node = topic.removesuffix(STATE)
            seconds, poses = columns_of([(at, m.x, m.y, m.theta) for at, m in known])
            covariances = np.moveaxis(np.array([m.covariance for _, m in known]).reshape(-1, 3, 3), 0, 2)
            track = Track(node, "estimate", robot_of(node), seconds, poses, covariances)
            healths = [m.health if isinstance(m.health, FilterHealth) else None for _, m in known]
            found.append(Estimated(track, np.array([m.n_eff for _, m in known]), healths))
    return [estimated for estimated in found if estimated.track.seconds.size]


def verdicts(estimated: Estimated, end: float) -> list[Span]:
    """Return how a filter judged itself over the run; nothing where it does not monitor its health."""
    spans: list[Span] = []
    before: list[HealthFigures] = []
    for at, health in zip(estimated.track.seconds.tolist(), estimated.health, strict=True):
        if health is None:
            continue
        if not spans or spans[-1].status != health.status:
            if spans:
                spans[-1] = spans[-1]._replace(end=at)
            if len(spans) == MOST_SPANS:
                return spans
            spans.append(Span(at, end, health.status, health.reason, changed(before, health.figures)))
            before = []
        before.append(health.figures)
    return spans


def shares(lasted: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the share of the time in each status, the largest first, by statuses and how long each lasted, in order.

    Where no time has passed, all of it is in the last status.
    """
    told = list(lasted)
    length = sum(seconds for _, seconds in told)
    if length <= 0.0:
        return {status: 1.0 for status, _ in told[-1:]}
    found: dict[str, float] = {}
    for status, seconds in told:
        found[status] = found.get(status, 0.0) + seconds / length
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def position_errors(track: Track, truth: Track) -> tuple[FloatArray, FloatArray]:
    """Return the times of those estimates that can be judged, and their distances from the truth, (T,) each."""
    if truth.seconds.size < 2 or not track.seconds.size:
        return np.empty(0), np.empty(0)
    seconds, errors, _ = _errors(track, truth)
    return seconds, np.sqrt(errors[0] * errors[0] + errors[1] * errors[1])


def error_plots(tracks: Sequence[Track], unit: str) -> list[Plot]:
    """Return the errors of estimates against the truth of the same robot, with what the filters expect of them.

    ``unit`` is that of positions.
    """
    truths = {track.robot: track for track in tracks if track.role == "truth" and track.seconds.size >= 2}
    judged = [track for track in tracks if track.role == "estimate" and track.robot in truths]
    several = len(judged) > 1
    # Odometry is shown on demand beside estimates: it soon leaves their scale.
    position: list[Line] = []
    heading: list[Line] = []
    squared: list[Line] = []
    for track in judged:
        seconds, errors, covariances = _errors(track, truths[track.robot])
        distance = np.sqrt(errors[0] * errors[0] + errors[1] * errors[1])
        sigma = 3.0 * np.sqrt(_greatest(covariances))
        turned = 3.0 * np.degrees(np.sqrt(np.maximum(covariances[2, 2], 0.0)))
        label = track.name if several else "error"
        position.append(Line(label, seconds, distance))
        heading.append(Line(label, seconds, np.degrees(errors[2])))
        squared.append(Line(track.name if several else "NEES", seconds, _nees(errors, covariances)))
        if not several:
            position.insert(0, Line("3 sigma", seconds, sigma, "band"))
            if np.any(turned > 0.0):
                heading.insert(0, Line("3 sigma", seconds, turned, "band"))
    position += [line._replace(hidden=bool(judged)) for line in _reckoned(tracks, truths)]
    if squared:
        ends = np.array([squared[0].seconds[0], squared[0].seconds[-1]]) if squared[0].seconds.size else np.empty(0)
        squared += [
            Line(f"95 % {word}", ends, np.full(ends.size, bound), "bound")
            for word, bound in zip(("low", "high"), CHI_SQUARE_2, strict=True)
        ]
    plots = (
        Plot("position_error", "Position error", unit, position, "Below the band the filter knows how far off it is."),
        Plot("heading_error", "Heading error", "deg", heading, signed=True),
        Plot(
            "nees",
            "NEES of the position",
            "",
            squared,
            "Squared error in units of its own covariance; of an honest filter 95 % lie between the dashed lines.",
        ),
    )
    return [plot for plot in plots if any(line.values.size for line in plot.lines)]


def filter_plots(estimates: Sequence[Estimated]) -> list[Plot]:
    """Return the effective numbers of particles, and what health monitors say of the evidence of readings."""
    several = len(estimates) > 1
    sizes, evidence = [], []
    for track, n_eff, health in estimates:
        if n_eff.size and np.any(n_eff > 1.0):
            sizes.append(Line(track.name if several else "effective", track.seconds, n_eff))
        told = [None if one is None else one.figures.log_likelihood for one in health]
        values = np.array([value if isinstance(value, float) else np.nan for value in told])
        if np.isfinite(values).any():
            evidence.append(Line(track.name if several else "log-likelihood", track.seconds, values))
    plots = (
        Plot("n_eff", "Effective sample size", "", sizes, "How many of the particles carry the weight."),
        Plot("evidence", "Evidence", "", evidence, "Log-likelihood of a reading, a short-term average.", signed=True),
    )
    return [plot for plot in plots if plot.lines]


def _errors(track: Track, truth: Track) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the times (T,) of those estimates that can be judged, their errors (3, T) and covariances (3, 3, T)."""
    dense = float(np.median(np.diff(truth.seconds))) <= MAX_GAP_S
    chosen = np.ones(track.seconds.size, bool) if dense else np.isin(track.seconds, truth.seconds)
    seconds, poses = track.seconds[chosen], track.poses[:, chosen]
    gap = MAX_GAP_S if dense else np.inf
    found = pose_errors(Trajectory(seconds, poses), Trajectory(truth.seconds, truth.poses), max_gap=gap)
    valid = found.position_valid
    covariances = np.full((3, 3, seconds.size), np.nan) if track.covariances is None else track.covariances[..., chosen]
    return seconds[valid], found.errors[:, valid], covariances[..., valid]


def _reckoned(tracks: Sequence[Track], truths: dict[str, Track]) -> list[Line]:
    """Return the errors of odometry alone."""
    lines = []
    for track in tracks:
        if track.role == "odometry" and track.robot in truths and track.seconds.size:
            seconds, errors, _ = _errors(track, truths[track.robot])
            label = f"odometry of {track.robot}" if track.robot else "odometry alone"
            distance = np.sqrt(errors[0] * errors[0] + errors[1] * errors[1])
            lines.append(Line(label, seconds, distance))
    return lines


def _greatest(covariances: FloatArray) -> FloatArray:
    """Return the variance of the position in the direction in which it is greatest, (T,)."""
    xx, xy, yy = covariances[0, 0], covariances[0, 1], covariances[1, 1]
    half = 0.5 * (xx - yy)
    return np.asarray(np.maximum(0.5 * (xx + yy) + np.sqrt(half * half + xy * xy), 0.0))


def _nees(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return e^T P^-1 e of the position, (T,); NaN where P is singular."""
    xx, xy, yy = covariances[0, 0], covariances[0, 1], covariances[1, 1]
    x, y = errors[0], errors[1]
    determinant = xx * yy - xy * xy
    regular: NDArray[np.bool_] = determinant > 0.0
    scaled = yy * x * x - 2.0 * xy * x * y + xx * y * y
    return np.where(regular, scaled / np.where(regular, determinant, 1.0), np.nan)
