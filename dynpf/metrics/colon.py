"""Measures of a capsule in a tube that changes: pose errors as COLON gives them, and what is known of the map."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dynpf.colon.beams import expected_ranges
from dynpf.colon.hypotheses import UNLISTED
from dynpf.maps.raycast import RayCaster
from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray, Floats

__all__ = ["LOST_PX", "TOLD_APART_PX", "capsule_errors", "first_visible", "map_errors"]

LOST_PX = 30.0
"""The capsule counts as lost when the estimate is farther off than this at the end."""
TOLD_APART_PX = 10.0
"""By how much a range must differ before a change of the map can be seen (prototypes saw none smaller)."""


def capsule_errors(true: Floats, pose: Floats) -> dict[str, float | bool]:
    """Return the errors of an estimated pose (3,); percentages are of the true coordinate, NaN where that is 0."""
    off = np.array([pose[0] - true[0], pose[1] - true[1], float(wrap_angle(pose[2] - true[2]))])
    percent = np.full(3, math.nan)
    np.divide(100.0 * np.abs(off), np.abs(true), out=percent, where=np.asarray(true) != 0.0)
    position = math.hypot(off[0], off[1])
    return {
        "error_x_percent": float(percent[0]),
        "error_y_percent": float(percent[1]),
        "error_theta_percent": float(percent[2]),
        "error_position_px": position,
        "error_theta_rad": float(abs(off[2])),
        "lost": position > LOST_PX,
    }


def map_errors(
    true: Sequence[str], found: Sequence[Mapping[str, float]], visible: int | None
) -> dict[str, float | bool]:
    """Return what a posterior over maps at each reading is worth: at the end, before a change, and from it on.

    ``true``: the map that holds at each reading; ``visible``: the first reading in which a change of it can be seen.
    A change counts as reported while the posterior of the first map is below 0.5. NaN is what does not apply.
    """
    measures: dict[str, float | bool] = {
        "posterior_truth": found[-1].get(true[-1], found[-1].get(UNLISTED, 0.0)),
        "false_alarm": math.nan,
        "missed": math.nan,
        "delay_steps": math.nan,
    }
    reported = [step for step, maps in enumerate(found) if maps.get(true[0], 0.0) < 0.5]
    if true[-1] == true[0]:
        return measures | {"false_alarm": bool(reported)}
    if visible is not None:
        since = [step for step in reported if step >= visible]
        measures |= {"missed": not since, "delay_steps": float(since[0] - visible) if since else math.nan}
    return measures


def first_visible(true: Sequence[str], poses: FloatArray, caster: Callable[[str], RayCaster]) -> int | None:
    """Return the first reading, at true poses (3, T), of which a range is another than in the first map."""
    for step, name in enumerate(true):
        pose = poses[:, step : step + 1]
        now, then = (expected_ranges(caster(held), pose) for held in (name, true[0]))
        if np.abs(now - then).max() > TOLD_APART_PX:
            return step
    return None
