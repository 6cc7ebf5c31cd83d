"""The elementary functions called once, so that none is compiled or loaded while a node has no time for that."""

import numpy as np

from dynpf import kernels
from dynpf.portable import functions

__all__ = ["rehearse"]


def rehearse() -> None:
    """Call every elementary function, of a number and of an array, and what draws normal numbers."""
    half, halves = 0.5, np.full(2, 0.5)
    for of_one in ("sin", "cos", "sincos", "tan", "exp", "expm1", "erf", "log", "log1p"):
        getattr(functions, of_one)(half)
        getattr(functions, of_one)(halves)
    for of_two in (functions.atan2, functions.hypot):
        of_two(half, half)
        of_two(halves, halves)
    kernels.functions.normals(halves, halves, np.empty(4))
