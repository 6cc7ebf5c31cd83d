import math
from typing import Any

import numpy as np
import pytest
from dynpf_runtime.node import decode_state, encode_state, state_digest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

DTYPES = [
    "bool",
    "int8",
    "uint8",
    "int16",
    "int32",
    "int64",
    "uint64",
    "float32",
    "float64",
    "complex128",
    ">f8",
    "<U3",
]
SHAPES: list[tuple[int, ...]] = [(), (0,), (3,), (0, 3), (2, 0, 1), (2, 3)]
EXACT = settings(derandomize=True, deadline=None, max_examples=50)

plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_keep_type_shape_and_bytes(dtype: str, shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(dtype)
    again = decode_state(encode_state({"inner": [{"array": array}]}))["inner"][0]["array"]
    assert (again.dtype, again.shape, again.tobytes()) == (array.dtype, array.shape, array.tobytes())
    again.fill(0)  # what is thawed is the node's own, to be changed


def test_numbers_that_compare_unequal_to_themselves_come_back() -> None:
    array = np.array([np.nan, -0.0, np.inf, 5e-324])
    assert decode_state(encode_state({"a": array}))["a"].tobytes() == array.tobytes()


@pytest.mark.parametrize("dtype", ["<f4", "<f8", ">f8"])
def test_one_nan_stands_for_all(dtype: str) -> None:
    array = np.array([np.nan, -np.nan, 1.0], dtype=dtype)
    usual = np.array([np.nan, np.nan, 1.0], dtype=dtype)
    assert array.tobytes() != usual.tobytes()
    assert encode_state({"a": [array]}) == encode_state({"a": [usual]})
    assert encode_state({"a": (-math.nan, array[1])}) == encode_state({"a": [math.nan, usual[1]]})
    assert array.tobytes() != usual.tobytes(), "the node's own array is left alone"


def test_the_layout_in_memory_does_not_count() -> None:
    array = np.arange(6.0).reshape(2, 3)
    strided = np.arange(12.0).reshape(2, 6)[:, ::2] / 2.0
    assert encode_state({"a": np.asfortranarray(array)}) == encode_state({"a": array})
    assert encode_state({"a": strided}) == encode_state({"a": array})
    assert encode_state({"a": array.T}) != encode_state({"a": array})


@EXACT
@given(state=st.dictionaries(st.text(), plain, min_size=2, max_size=5))
def test_plain_values_come_back_and_the_order_of_keys_does_not_count(state: dict[str, Any]) -> None:
    assert decode_state(encode_state(state)) == state
    assert encode_state(dict(reversed(state.items()))) == encode_state(state)


@EXACT
@given(array=hnp.arrays(st.sampled_from(["f8", "i4", "u1"]), hnp.array_shapes(max_dims=3, max_side=4)), data=st.data())
def test_one_bit_changes_the_digest(array: np.ndarray, data: st.DataObject) -> None:
    before = state_digest({"array": array})
    changed = array.copy()
    bits = changed.view(np.uint8).reshape(-1)
    bits[data.draw(st.integers(0, bits.size - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assume(not np.array_equal(changed, array, equal_nan=True) or np.any((array == 0) & (changed == 0)))
    assert state_digest({"array": changed}) != before
    assert state_digest({"array": array.copy()}) == before
    assert state_digest({"another": array}) != before


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (object(), "a object"),
        (np.array([object()]), "an array of object"),
        (np.zeros(2, dtype=[("x", "f8")]), r"an array of \[\('x', '<f8'\)\]"),
    ],
)
def test_what_has_no_bytes_of_its_own_is_refused(value: object, named: str) -> None:
    with pytest.raises(TypeError, match=f"a node's state holds {named}; expected"):
        encode_state({"value": value})


def test_a_foreign_extension_is_refused() -> None:
    data = encode_state({"a": np.zeros(1)}).replace(b"\x01", b"\x02", 1)
    with pytest.raises(ValueError, match="extension 2"):
        decode_state(data)
