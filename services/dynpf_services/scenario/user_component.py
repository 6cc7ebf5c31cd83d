"""A table of a scenario that names a user class instead of a class of dynpf."""

from typing import Any

import msgspec

__all__ = ["UserComponent"]


class UserComponent(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="package.module:Name"
):
    """A class of your own. All other keys of the table are its parameters; see "Your own components" above."""

    # In a file, and in a resolved scenario, ``kind`` is the name, and the parameters are keys beside it.
    name: str
    parameters: dict[str, Any] = {}
