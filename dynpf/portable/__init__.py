"""Arithmetic with the same bits on every machine: what nodes use where NumPy or the C library choose by processor.

``sin``, ``exp`` and the like come from polynomials of our own, matrices of up to some fifteen rows are multiplied and
solved in a fixed order. Everything is float64; an argument of another type is converted first. What NumPy does with
additions, multiplications, divisions, square roots, comparisons and sums is the same everywhere and needs no
replacement (docs/machines.md says what is, and why).
"""

from dynpf.portable.functions import (
    atan2,
    cos,
    dist,
    erf,
    exp,
    expm1,
    hypot,
    log,
    log1p,
    logaddexp,
    normal_quantile,
    power,
    sin,
    sinc,
    sincos,
    tan,
    whole,
)
from dynpf.portable.linear import (
    SingularMatrixError,
    eigh,
    inverse,
    log_determinant,
    norm,
    product,
    singular_values,
    solve,
)
from dynpf.portable.rehearsal import rehearse

__all__ = [
    "SingularMatrixError",
    "atan2",
    "cos",
    "dist",
    "eigh",
    "erf",
    "exp",
    "expm1",
    "hypot",
    "inverse",
    "log",
    "log1p",
    "log_determinant",
    "logaddexp",
    "norm",
    "normal_quantile",
    "power",
    "product",
    "rehearse",
    "sin",
    "sinc",
    "sincos",
    "singular_values",
    "solve",
    "tan",
    "whole",
]
