"""The names of numpy, cv2 and math that portable code may use, by the reason why their bits are everywhere the same."""

__all__ = ["CASTS", "EXACT", "METHODS"]

_BY_REASON = {
    "a type, a constant, an error, or what carries them": """
        numpy: bool_ dtype errstate finfo floating float32 float64 generic iinfo inf integer nan ndarray newaxis pi
        numpy: int8 int16 int32 int64 intp uint8 uint16 uint32 uint64 random random.Generator random.Philox
        numpy: typing.ArrayLike typing.NDArray
        math: inf nan pi tau
        cv2: error
    """,
    "moves, counts or compares numbers and makes no new ones": """
        numpy: all any append argmax argmin argwhere array array_equal array_split asarray ascontiguousarray atleast_1d
        numpy: atleast_2d bincount broadcast_arrays broadcast_shapes broadcast_to clip column_stack concatenate copyto
        numpy: copysign count_nonzero delete diag diagonal empty empty_like eye fill_diagonal flatnonzero flip fmax fmin
        numpy: frombuffer full full_like hstack indices isfinite isin isinf isnan isneginf isposinf logical_and
        numpy: logical_not logical_or logical_or.accumulate max maximum maximum.accumulate meshgrid min minimum
        numpy: minimum.accumulate minimum.at moveaxis ndindex nextafter nonzero ones ones_like packbits pad ptp repeat
        numpy: reshape roll searchsorted setdiff1d shape sign signbit size split squeeze stack swapaxes take
        numpy: take_along_axis tile transpose tril_indices triu_indices unpackbits unravel_index vstack where zeros
        numpy: zeros_like
        math: copysign fabs isfinite isinf isnan
    """,
    "IEEE 754's own operations, each rounded once, in an order that NumPy fixes": """
        numpy: abs absolute add add.at add.reduce add.reduceat ceil cumprod cumsum diff divide floor gradient linspace
        numpy: mean multiply multiply.outer negative outer prod rint sqrt square std subtract sum trunc var
        math: ceil floor radians degrees sqrt trunc
    """,
    "exact by definition, whatever the way": """
        numpy: divmod fmod mod remainder
        math: comb factorial fmod frexp fsum gcd isqrt ldexp prod remainder
        decimal: Decimal
    """,
    "of whole numbers, for which `calls` looks": """
        numpy: arange
    """,
    "stable, for which `calls` looks": """
        numpy: argsort lexsort sort
    """,
    "picks values, and of equal ones it does not matter which": """
        numpy: median unique
    """,
}


def _names(table: str) -> tuple[str, ...]:
    rows = (row.partition(":") for row in table.strip().splitlines())
    return tuple(f"{module.strip()}.{name}" for module, _, names in rows for name in names.split())


EXACT = {reason: _names(table) for reason, table in _BY_REASON.items()}

METHODS = {
    **dict.fromkeys(("dot", "trace"), "BLAS sums in an order of its own; take dynpf.portable.product"),
    "argpartition": "the order of equal values is the processor's; take argsort with kind='stable'",
    **dict.fromkeys(("imag", "conjugate", "conj"), "a complex number's: its products are rounded once or twice"),
}
"""Methods that are refused by their name alone: of what, cannot be seen."""

CASTS: dict[tuple[str, str], str] = {}
"""File and function in which a number is cast to a whole one, and why it cannot be out of range there."""
