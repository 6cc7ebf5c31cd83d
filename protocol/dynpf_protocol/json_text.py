"""JSON from elsewhere: whatever is wrong with it is one error."""

from typing import TypeVar

import msgspec

__all__ = ["read_json"]

_T = TypeVar("_T")


def read_json(data: bytes | str, kind: type[_T]) -> _T:
    """Return the value of JSON text as a ``kind``.

    Raises msgspec.DecodeError, also for bytes that are not UTF-8 and for what is nested too deeply to be read.
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except (UnicodeError, RecursionError) as error:
        raise msgspec.DecodeError(str(error)) from error
