"""COLON: a capsule in a tube whose walls change, and filters that take the map for part of what is estimated."""

from dynpf.colon.bore import bore
from dynpf.colon.world import CASES, ROUTE, Capsule, Case, Run, simulate

__all__ = ["CASES", "ROUTE", "Capsule", "Case", "Run", "bore", "simulate"]
