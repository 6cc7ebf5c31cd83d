"""Landmarks: what a scenario, a log and the sensors call by the same number."""

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Landmark"]


class Landmark(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A landmark that can be told from the others; metres."""

    id: Annotated[int, Meta(ge=0)]
    x: float
    y: float
