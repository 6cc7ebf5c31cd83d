"""COLON: a capsule in a tube whose walls change, and filters that take the map for part of what is estimated."""

from dynpf.colon.bore import bore
from dynpf.colon.classic import Classic
from dynpf.colon.end_radius import EndRadius, EndRadiusParams
from dynpf.colon.hypotheses import UNLISTED, Hypotheses, HypothesesParams
from dynpf.colon.world import CASES, ROUTE, Capsule, Case, Run, simulate

__all__ = [
    "CASES",
    "ROUTE",
    "UNLISTED",
    "Capsule",
    "Case",
    "Classic",
    "EndRadius",
    "EndRadiusParams",
    "Hypotheses",
    "HypothesesParams",
    "Run",
    "bore",
    "simulate",
]
