"""Measures of one recorded run against the truth in it, under the names that scripts hold on to.

What each figure is stands in the module of its subject: ``localization``, ``rearrangement``, ``capsule``. Of every run
there are ``messages``, how many it recorded; ``gaps``, how many are missing; ``complete``, whether it was recorded to
its end; ``content_digest``; and, where it has several estimators, ``estimators``: the localization of each by its name.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.messages import Estimate
from dynpf_services.scenario.load import override_resolved
from dynpf_systems.parts.config import RearrangementConfig

from dynpf_lab.measures.capsule import capsule, capsule_summary
from dynpf_lab.measures.localization import localization
from dynpf_lab.measures.messages import RunMessages, recorded
from dynpf_lab.measures.rearrangement import course_of, filter_measures, rearrangement

__all__ = ["differing", "measure", "measure_run", "summary"]


def measure(recording: Recording) -> dict[str, Any]:
    """Return the measures of a run; those that it holds no data for are left out."""
    return {**_figures(recording), "content_digest": content_digest(recording)}


def measure_run(run: RunMessages) -> dict[str, Any]:
    """Return the measures of a run by its messages alone."""
    measures = localization(run)
    course = course_of(run)
    if course is not None:
        config = run.scenario.estimator
        measures |= rearrangement(course)
        if isinstance(config, RearrangementConfig):
            measures |= filter_measures(course, config.filter)
    return measures | capsule(run)


def differing(a: Recording, b: Recording) -> dict[str, tuple[Any, Any]]:
    """Return the measures, without the digest, in which two runs differ: both values, None where a run lacks one."""
    left, right = _figures(a), _figures(b)
    names = [*left, *(name for name in right if name not in left)]
    return {name: (left.get(name), right.get(name)) for name in names if left.get(name) != right.get(name)}


def _beside_one_another(recording: Recording, run: RunMessages) -> dict[str, Any]:
    """Return the localization of each estimator of a run that has several, by its name."""
    names = [name for name in recording.header.writes if _is_estimate(recording, f"{name}/state")]
    return {"estimators": {name: localization(run, name) for name in names}} if len(names) > 1 else {}


def _is_estimate(recording: Recording, topic: str) -> bool:
    row = recording.topics.get(topic)
    return topic in recording.schemas and row is not None and row.type is Estimate


def _figures(recording: Recording) -> dict[str, Any]:
    end, run = recording.end, recorded(recording)
    return {
        **measure_run(run),
        **_beside_one_another(recording, run),
        "messages": sum(1 for _ in recording.messages()),
        "gaps": end.missing if end is not None else None,
        "complete": end is not None and end.complete and not recording.truncated,
    }


def summary(recording: Recording, measures: Mapping[str, Any]) -> str:
    """Return the measures as a person reads them."""
    scenario = override_resolved(recording.header.scenario, (), str(recording.path))
    state = "complete" if measures["complete"] else "INCOMPLETE"
    reason = recording.end.reason if recording.end is not None else "it was never closed"
    lines = [f"{scenario.title} (seed {scenario.seed})", f"recording   {recording.path}, {state}: {reason}"]
    topic = "estimator/capsule" if "error_position_px" in measures else "estimator/state"
    stamps = [record.stamp_ns for record in recording.messages(topic)]
    if stamps:
        lines.append(f"duration    {(max(stamps) - min(stamps)) * 1e-9:.1f} s of logical time, {len(stamps)} estimates")
    lines.append(f"messages    {measures['messages']}, {measures['gaps']} missing")
    if "completed" in measures:
        home = "all parts home" if measures["completed"] else "NOT all parts home"
        error_cm = 100.0 * measures["final_error_max_m"]
        collisions = measures["collisions"]
        lines.append(f"task        {home}, {collisions} collisions, farthest part {error_cm:.2f} cm from its goal")
        lines.append(f"paths       npl {measures['npl']:.3f}, nrl {measures['nrl']:.3f} (1 = straight lines)")
    if "crlb_ratio" in measures:
        lines.append(f"bound       robot's RMS error {measures['crlb_ratio']:.2f} times the Cramer-Rao bound")
    if "position_rmse_m" in measures:
        text = f"position    RMSE {measures['position_rmse_m']:.4f} m, median {measures['position_median_m']:.4f} m"
        if "dead_reckoning_rmse_m" in measures:
            text += f"; odometry alone {measures['dead_reckoning_rmse_m']:.3f} m"
        lines.append(text)
    if "heading_rmse_rad" in measures:
        lines.append(f"heading     RMSE {np.degrees(measures['heading_rmse_rad']):.2f} deg")
    if "error_position_px" in measures:
        lines += capsule_summary(measures)
    if "estimators" in measures:
        lines += _table(measures["estimators"])
    lines.append(f"digest      {measures['content_digest']}")
    return "\n".join(lines)


def _table(estimators: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return a line for each estimator of a run: position and heading errors, and how consistent it is."""
    width = max(len(name) for name in (*estimators, "estimator"))
    rows = [f"{'estimator':<{width}}  RMSE m  median m  heading deg   NEES  lost"]
    for name, figures in estimators.items():
        cells = (
            f"{figures.get('position_rmse_m', np.nan):6.4f}",
            f"{figures.get('position_median_m', np.nan):8.4f}",
            f"{np.degrees(figures.get('heading_rmse_rad', np.nan)):11.2f}",
            f"{figures.get('nees_mean', np.nan):5.2f}",
            f"{100.0 * figures.get('lost_fraction', np.nan):3.0f}%",
        )
        rows.append("  ".join((f"{name:<{width}}", *cells)))
    return rows
