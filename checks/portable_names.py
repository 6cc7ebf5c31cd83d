"""What portable code may use of numpy, cv2 and math, and where it may cast, each by the reason why that is portable."""

__all__ = ["CASTS", "EXACT", "METHODS"]

_BY_REASON = {
    "a type, a constant, an error, or what carries them": """
        numpy: bool_ dtype errstate finfo floating float32 float64 generic iinfo inf integer nan ndarray newaxis pi
        numpy: int8 int16 int32 int64 intp uint8 uint16 uint32 uint64 random random.Generator random.Philox
        numpy: typing.ArrayLike typing.NDArray
        math: inf nan pi tau
        cv2: CC_STAT_AREA CHAIN_APPROX_NONE COLOR_BGR2GRAY CV_32S DIST_L2 DIST_LABEL_PIXEL IMREAD_REDUCED_GRAYSCALE_4
        cv2: IMREAD_UNCHANGED IMWRITE_JPEG_QUALITY INTER_AREA LINE_8 RETR_CCOMP error
        decimal: InvalidOperation
    """,
    "moves, counts or compares numbers and makes no new ones": """
        numpy: all any append argmax argmin argwhere array array_equal array_split asarray ascontiguousarray atleast_1d
        numpy: atleast_2d bincount broadcast_arrays broadcast_shapes broadcast_to clip column_stack concatenate copyto
        numpy: copysign count_nonzero delete diag diagonal empty empty_like eye fill_diagonal flatnonzero flip fmax fmin
        numpy: frombuffer full full_like hstack indices isfinite isin isinf isnan isneginf isposinf logical_and
        numpy: logical_not logical_or logical_or.accumulate max maximum maximum.accumulate meshgrid min minimum
        numpy: minimum.accumulate minimum.at moveaxis ndindex nextafter nonzero ones ones_like packbits pad ptp repeat
        numpy: require reshape roll searchsorted setdiff1d shape sign signbit size split squeeze stack swapaxes take
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
        numpy: argsort lexsort
    """,
    "orders or picks values, of which equal ones are the same, but for the sign of zero": """
        numpy: median sort unique
    """,
    "the one value in its place, for which `calls` looks": """
        numpy: partition
    """,
    "computes in whole numbers: labels, borders, fixed-point coordinates, the largest grey value": """
        cv2: circle connectedComponents connectedComponentsWithStats convexHull dilate fillConvexPoly findContours
    """,
    "computes in float64, but of whole pixels below 4096, of which products of four are below 2**53": """
        cv2: approxPolyDP contourArea
    """,
    "labels, by comparisons of distances in fixed point; only the distances themselves become float32": """
        cv2: distanceTransformWithLabels
    """,
    "of uint8 in fixed point or whole sums; checks/opencv_bits.py shows it, with any instructions, place, IPP": """
        cv2: cvtColor resize
    """,
    "whole-number transforms of libjpeg-turbo, and libpng, which is lossless; checks/opencv_bits.py shows it, too": """
        cv2: imdecode imencode
    """,
}


def _rows(table: str) -> list[tuple[str, str, str]]:
    return [row.partition(":") for row in table.strip().splitlines()]


def _names(table: str) -> tuple[str, ...]:
    return tuple(f"{module.strip()}.{name}" for module, _, names in _rows(table) for name in names.split())


EXACT = {reason: _names(table) for reason, table in _BY_REASON.items()}

METHODS = {
    **dict.fromkeys(("dot", "trace"), "BLAS sums in an order of its own; take dynpf.portable.product"),
    "argpartition": "the order of equal values is the processor's; take argsort with kind='stable'",
    **dict.fromkeys(("imag", "conjugate", "conj"), "a complex number's: its products are rounded once or twice"),
}
"""Methods that are refused by their name alone: of what, cannot be seen."""

_CASTS_BY_REASON = {
    "whole already: only its width changes, or how its sign is read": """
        dynpf/kernels/background.py: sample
        dynpf/kernels/bins.py: _slot _join_neighbours occupied clusters
        dynpf/kernels/distance.py: squared_distances
        dynpf/kernels/elementary.py: whole log
        dynpf/kernels/drawing.py: add_noise
        dynpf/kernels/fields.py: _place _extended
        dynpf/kernels/philox.py: words fill_normals fill_uniforms two_words
        dynpf/kernels/rays.py: fill_cones trace
        dynpf/vision/subsample.py: subsample
        formats/dynpf_formats/importers/maps.py: map_of_message
        systems/dynpf_systems/parts/vision.py: _decode
    """,
    "made of Python's own numbers, of which NumPy refuses what does not fit": """
        dynpf/filters/extended.py: __init__
        dynpf/filters/unscented.py: __init__
        dynpf/maps/landmarks.py: __init__ columns
        dynpf/measurement/range_bearing.py: __init__
        formats/dynpf_formats/importers/mrclam_tables.py: of
    """,
    "bounded just before: by comparisons that NaN fails, or by max(bound, x), which is the bound if x is NaN": """
        dynpf/kernels/beam.py: sum_over_beams
        dynpf/kernels/bins.py: _fill_keys
        dynpf/kernels/cloud.py: systematic
        dynpf/kernels/drawing.py: _step
        dynpf/kernels/edges.py: _bilinear
        dynpf/kernels/fields.py: interpolate
        dynpf/kernels/likelihood_field.py: sum_over_beams _find_cells
        dynpf/kernels/rays.py: _aim
    """,
    "its only caller, changed, bounds the place, also if it is NaN": """
        dynpf/kernels/colon_walls.py: _between_cells changed
    """,
    "whole already, or a ray's row, of which `_aim` bounds intercept and slope, and the grid the column": """
        dynpf/kernels/rays.py: _leap _finish
    """,
    "a mean, by a share from 0 to 1, of two grey levels from 0 to 255": """
        dynpf/kernels/drawing.py: _mixed
    """,
    "a number of samples, made of constants": """
        dynpf/kernels/edges.py: rims
    """,
}

CASTS = {
    reason: {(file.strip(), name) for file, _, names in _rows(table) for name in names.split()}
    for reason, table in _CASTS_BY_REASON.items()
}
"""Files and functions in which a number is cast to a whole one, by the reason why it cannot be out of range there."""
