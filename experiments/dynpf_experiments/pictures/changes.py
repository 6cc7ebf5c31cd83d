"""What changed in the figures behind a filter's verdict when it came to another one."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from dynpf_protocol.messages import HealthFigures
from msgspec import UNSET

__all__ = ["changed"]


class _Figure(NamedTuple):
    """A figure in words, its unit, and by how much it has to differ to be named: by a factor, or by so much."""

    words: str
    unit: str = ""
    factor: float = 0.0
    step: float = 0.0


_FIGURES = {
    "position_sigma": _Figure("standard deviation of the position", " m", factor=2.0),
    "heading_sigma": _Figure("of the heading", " rad", factor=2.0),
    "log_likelihood": _Figure("log-likelihood of a reading", step=1.0),
    "likelihood_ratio": _Figure("readings' likelihood over the usual", factor=1.5),
    "refused_share": _Figure("share of readings not believed", step=0.2),
    "mode_mass": _Figure("share of the heaviest mode", step=0.2),
    "n_eff_share": _Figure("effective particles as a share of all", factor=3.0),
    "impossible": _Figure("updates in a row that no particle explains", step=1.0),
}


def changed(before: Sequence[HealthFigures], now: HealthFigures) -> str:
    """Return which figures are not what they were in the median of those ``before``; an empty text without any."""
    told = []
    for name, figure in _FIGURES.items():
        value = getattr(now, name)
        past = [other for other in (getattr(each, name) for each in before) if other is not UNSET]
        if value is UNSET or not past:
            continue
        usual = float(np.median(past))
        if _differs(usual, value, figure):
            told.append(f"{figure.words} {usual:.3g} -> {value:.3g}{figure.unit}")
    return ", ".join(told)


def _differs(usual: float, value: float, figure: _Figure) -> bool:
    if figure.factor:
        least, most = sorted((abs(usual), abs(value)))
        return most > figure.factor * least
    return abs(value - usual) >= figure.step
