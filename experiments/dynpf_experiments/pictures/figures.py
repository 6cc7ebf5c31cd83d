"""The measures of a run as rows of a table: names in words, values with their units and intervals."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["Figure", "figures"]

LEFT_OUT = frozenset({"content_digest", "messages", "gaps", "complete", "outcome", "estimators"})
_UNITS = {
    "_m": ("m", 1.0),
    "_cm": ("cm", 1.0),
    "_px": ("px", 1.0),
    "_rad": ("deg", 180.0 / math.pi),
    "_db": ("dB", 1.0),
    "_steps": ("steps", 1.0),
    "_percent": ("%", 1.0),
    "_fraction": ("%", 100.0),
}
_SHARE = "_by_verdict"
_WORDS = {
    "rmse": "RMSE",
    "p95": "95th percentile",
    "nees": "NEES",
    "npl": "NPL",
    "nrl": "NRL",
    "pi": "PI",
    "rpee": "RPEE",
    "ppee": "PPEE",
    "crlb": "Cramer-Rao",
    "snr": "SNR",
}


class Figure(NamedTuple):
    """A measure: its stable name, the same in words, value, unit, and the interval that it is judged by, or ""."""

    name: str
    label: str
    value: str
    unit: str
    interval: str


def figures(measures: Mapping[str, Any]) -> list[Figure]:
    """Return the measures of a run, or of an estimator of it, as rows."""
    found = []
    for name, value in measures.items():
        base = name.removesuffix("_mean")
        ends = (f"{base}_low", f"{base}_high")
        is_end = name.endswith(("_low", "_high")) and f"{name.rpartition('_')[0]}_mean" in measures
        if name in LEFT_OUT or is_end or not isinstance(value, bool | int | float):
            continue
        unit, scale, bare = _unit(name)
        interval = ""
        if name.endswith("_mean") and all(end in measures for end in ends):
            low, high = (_number(measures[end] * scale) for end in ends)
            interval = f"{low} to {high}"
        found.append(Figure(name, _words(bare), _value(value, scale), unit, interval))
    return found


def _unit(name: str) -> tuple[str, float, str]:
    if name.endswith(_SHARE):
        return "%", 100.0, name
    end = next((end for end in _UNITS if name.endswith(end)), "")
    unit, scale = _UNITS.get(end, ("", 1.0))
    return unit, scale, name.removesuffix(end)


def _words(name: str) -> str:
    words = [_WORDS.get(word, word) for word in name.split("_")]
    return " ".join([words[0][:1].upper() + words[0][1:], *words[1:]])


def _value(value: float | bool, scale: float) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value) if isinstance(value, int) else _number(value * scale)


def _number(value: float) -> str:
    return f"{value:.4g}"
