"""The measures of a robot's localization in words, for a person."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["LOST_M", "lines_of"]

LOST_M = 1.0
"""The robot counts as lost while the estimate is farther than this from the truth, in metres."""

_SHARE = "_by_verdict"


def lines_of(measures: Mapping[str, Any]) -> list[str]:
    """Return the measures of a run's localization as lines of a table: what is told, then figures with their units."""
    lines = []
    if "position_rmse_m" in measures:
        text = f"position    RMSE {measures['position_rmse_m']:.4f} m, median {measures['position_median_m']:.4f} m"
        if "dead_reckoning_rmse_m" in measures:
            text += f"; odometry alone {measures['dead_reckoning_rmse_m']:.3f} m"
        lines.append(text)
    if "heading_rmse_rad" in measures:
        lines.append(f"heading     RMSE {math.degrees(measures['heading_rmse_rad']):.2f} deg")
    if "nees_mean" in measures:
        lines.append(_consistency_in_words(measures))
    if "lost_fraction" in measures:
        lines.append(
            f"lost        {100.0 * measures['lost_fraction']:.0f} % of the time, farther than {LOST_M:g} m away"
        )
    if shares := {name.removesuffix(_SHARE): value for name, value in measures.items() if name.endswith(_SHARE)}:
        told = ", ".join(f"{name.replace('_', ' ')} {100.0 * share:.0f} %" for name, share in shares.items() if share)
        lines.append(f"health      {told} of the time, by the filter's own verdict")
    if "near_walls_fraction" in measures:
        lines.append(_fit_in_words(measures))
    if "alignment" in measures:
        lines += _frames(measures["alignment"])
    if theirs := measures.get("robot_localization"):
        lines.append(_theirs(theirs))
    if "unscored" in measures:
        lines.append(f"position    not scored: {measures['unscored']}")
    return lines + (_table(measures["estimators"]) if "estimators" in measures else [])


def _consistency_in_words(measures: Mapping[str, Any]) -> str:
    """Return NEES, the band of an honest filter, and what a figure outside of it means."""
    nees, low, high = (measures[f"nees_{name}"] for name in ("mean", "low", "high"))
    meaning = "errors as the filter expects them"
    if nees < low:
        meaning = "errors are smaller than the filter expects"
    elif nees > high:
        meaning = "errors are larger than the filter expects"
    return f"NEES        {nees:.3g}, {low:.2f} to {high:.2f} if honest: {meaning}"


def _fit_in_words(measures: Mapping[str, Any]) -> str:
    near = f"{100.0 * measures['near_walls_fraction']:.0f} % of the beams end within 10 cm of a wall at the estimates"
    chance = measures.get("near_walls_by_chance_fraction")
    return f"fit         {near}" + (f", {100.0 * chance:.0f} % would anywhere on the map" if chance is not None else "")


def _theirs(found: Mapping[str, Any]) -> str:
    """Return what to say of the localization that ran on the robot."""
    if "from_ours_median_m" in found:
        return f"robot's own localization {found['from_ours_median_m']:.3f} m from ours in the median"
    other = found.get("alignment")
    figures = other or found
    told = (
        f"RMSE {figures.get('position_rmse_m', np.nan):.4f} m, median {figures.get('position_median_m', np.nan):.4f} m"
    )
    where = " after alignment: it is in another frame than the reference" if other else ""
    return f"robot's own localization {told}{where}"


def _frames(found: Mapping[str, Any]) -> list[str]:
    """Return what to say of an error that a change of frames makes much smaller."""
    x, y, theta = found["truth_offset"]
    offset = f"{x:.4f} {y:.4f} {theta:.5f}"
    left = f"RMSE {found['position_rmse_m']:.4f} m, median {found['position_median_m']:.4f} m"
    return [
        f"frames      after alignment: {left}; offset {x:.3f} m, {y:.3f} m, {math.degrees(theta):.2f} deg",
        "            The reference looks like another frame, or the filter follows another place that looks alike.",
        f"            Import with --truth-offset {offset}, or score with dynpf metrics --truth-align.",
    ]


def _table(estimators: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return a line for each estimator of a run: position and heading errors, and how consistent it is."""
    width = max(len(name) for name in (*estimators, "estimator"))
    rows = [f"{'estimator':<{width}}  RMSE m  median m  heading deg   NEES  lost"]
    for name, figures in estimators.items():
        cells = (
            f"{figures.get('position_rmse_m', np.nan):6.4f}",
            f"{figures.get('position_median_m', np.nan):8.4f}",
            f"{math.degrees(figures.get('heading_rmse_rad', np.nan)):11.2f}",
            f"{figures.get('nees_mean', np.nan):5.2f}",
            f"{100.0 * figures.get('lost_fraction', np.nan):3.0f}%",
        )
        rows.append("  ".join((f"{name:<{width}}", *cells)))
    return rows
