"""Messages built from their types: any value that a type admits, long tuples kept short."""

from typing import Any

import msgspec
from hypothesis import strategies as st
from msgspec import inspect

LONGEST = 3  # of what a type leaves open, so that scenes with their many lists stay small
INTEGERS = 2**63 - 1


def built(kind: type) -> st.SearchStrategy[Any]:
    """Return a strategy for instances of a struct, with every field, default or not, drawn."""
    return _of(inspect.type_info(kind))


def _of(info: inspect.Type) -> st.SearchStrategy[Any]:
    match info:
        case inspect.StructType(cls=cls, fields=fields):
            return st.builds(cls, **{field.name: _of(field.type) for field in fields})
        case inspect.FloatType(ge=ge, gt=gt, le=le):
            low = ge if ge is not None else gt
            return st.floats(low, le, exclude_min=gt is not None, allow_nan=False, allow_infinity=False)
        case inspect.IntType(ge=ge, lt=lt, le=le):
            high = le if le is not None else (lt - 1 if lt is not None else INTEGERS)
            return st.integers(-INTEGERS if ge is None else ge, high)
        case inspect.BoolType():
            return st.booleans()
        case inspect.StrType(min_length=low, max_length=high):
            return st.text(min_size=low or 0, max_size=8 if high is None else min(high, 8))
        case inspect.BytesType():
            return st.binary(max_size=16)
        case inspect.LiteralType(values=values):
            return st.sampled_from(values)
        case inspect.EnumType(cls=cls):
            return st.sampled_from(list(cls))
        case inspect.VarTupleType(item_type=item, min_length=low, max_length=high):
            least = low or 0
            most = max(least, LONGEST if high is None else min(high, LONGEST))
            return st.lists(_of(item), min_size=least, max_size=most).map(tuple)
        case inspect.DictType(key_type=key, value_type=value):
            return st.dictionaries(_of(key), _of(value), max_size=LONGEST)
        case inspect.UnionType(types=types):
            return st.one_of([_of(one) for one in types])
        case inspect.NoneType():
            return st.none()
    raise NotImplementedError(f"no strategy for {info}")


def plainest(kind: type) -> Any:
    """Return one message of a type: each required number 1 or the nearest that is allowed, one item a list."""
    return msgspec.convert(_plainest(inspect.type_info(kind)), kind)


def _plainest(info: inspect.Type) -> Any:
    match info:
        case inspect.StructType(fields=fields):
            return {field.name: _plainest(field.type) for field in fields}
        case inspect.FloatType():
            return 1.0
        case inspect.IntType(ge=ge):
            return ge or 0
        case inspect.BoolType():
            return True
        case inspect.StrType():
            return "text"
        case inspect.BytesType():
            return "AA=="
        case inspect.LiteralType(values=values):
            return values[0]
        case inspect.EnumType(cls=cls):
            return next(iter(cls)).value
        case inspect.VarTupleType(item_type=item, min_length=low):
            return [_plainest(item)] * (low or 1)
        case inspect.DictType():
            return {"text": 1}
    raise NotImplementedError(f"no value for {info}")
