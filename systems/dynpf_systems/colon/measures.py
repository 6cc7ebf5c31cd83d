"""Measures of COLON: errors of the capsule's last pose estimate, and of the posterior over maps during the run."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from dynpf_experiments.measures import Measures
from dynpf_experiments.messages import RunMessages, of_type
from dynpf_services.scenario.context import Context

from dynpf.maps.raycast import RayCaster
from dynpf.metrics.colon import capsule_errors, first_visible, map_errors
from dynpf_systems.colon.messages import CapsuleEstimate, CapsuleState
from dynpf_systems.colon.tube import colon_world

__all__ = ["MEASURES", "capsule", "radius_error"]

_AXES = ("x", "y", "theta")


def capsule(run: RunMessages) -> dict[str, Any]:
    """Return the measures of a run with a capsule; an empty dictionary for other runs.

    ``error_x_percent`` and so on, ``lost``: see ``capsule_errors``; ``posterior_truth``, ``delay_steps``,
    ``false_alarm``, ``missed``: see ``map_errors``; ``error_radius_percent``: see ``radius_error``.
    """
    states = of_type(run.topic("truth/capsule"), CapsuleState)
    estimates = of_type(run.topic("estimator/capsule"), CapsuleEstimate) if states else []
    by_reading = {state.reading: state for state in states}
    followed = [(by_reading[estimate.reading], estimate) for estimate in estimates if estimate.reading in by_reading]
    if not followed:
        return {}
    true = np.array([(state.x_px, state.y_px, state.theta) for state, _ in followed]).T
    last = followed[-1][1]
    measures: dict[str, Any] = capsule_errors(true[:, -1], np.array([last.x_px, last.y_px, last.theta]))
    held = [state.map for state, _ in followed]
    if last.maps:
        posteriors = [{entry.map: entry.probability for entry in estimate.maps} for _, estimate in followed]
        casters = _casters(run)
        if casters.keys() >= {*held}:  # else the truth is in a map that the scenario does not have
            measures |= map_errors(held, posteriors, first_visible(held, true, casters.__getitem__))
    if isinstance(last.end_radius_px, float):
        measures["error_radius_percent"] = radius_error(last.end_radius_px, held[-1])
    return {name: value for name, value in measures.items() if np.isfinite(value)}


def radius_error(radius_px: float, true_map: str) -> float:
    """Return the error of the radius of the tube's round end, in % of the true radius in the map's name.

    NaN where the name has none.
    """
    named = re.fullmatch(r"end (\d{1,6}(?:\.\d{1,6})?)", true_map)
    true = float(named[1]) if named else 0.0
    return 100.0 * abs(radius_px - true) / true if true > 0.0 else math.nan


def _casters(run: RunMessages) -> dict[str, RayCaster]:
    world = colon_world(Context(run.with_files(), "metrics"))
    return {name: RayCaster(grid) for name, grid in world.true_grids().items()}


def _lines(measures: Mapping[str, Any]) -> list[str]:
    if "error_position_px" not in measures:
        return []
    shares = [f"{measures[f'error_{name}_percent']:.3f}" for name in _AXES if f"error_{name}_percent" in measures]
    lost = ", LOST" if measures["lost"] else ""
    lines = [
        f"final pose  {measures['error_position_px']:.2f} px and {measures['error_theta_rad']:.4f} rad off{lost};"
        f" {' / '.join(shares)} % of x, y, theta"
    ]
    if "posterior_truth" in measures:
        text = f"map         probability of the true one at the end {measures['posterior_truth']:.3f}"
        if "delay_steps" in measures:
            text += f", change reported {measures['delay_steps']:.0f} readings after it could be seen"
        if measures.get("missed"):
            text += ", change NOT reported"
        if measures.get("false_alarm"):
            text += ", change reported that there was NOT"
        lines.append(text)
    if "error_radius_percent" in measures:
        lines.append(f"end radius  {measures['error_radius_percent']:.2f} % off")
    return lines


MEASURES = Measures(
    estimate=CapsuleEstimate,
    reads=(CapsuleState, CapsuleEstimate),
    truths=("truth/capsule",),
    of_run=capsule,
    lines=_lines,
)
