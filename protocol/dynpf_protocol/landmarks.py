"""Landmarks, which a scenario, a log and the sensors identify by the same number."""

import msgspec

from dynpf_protocol.numbers import Count

__all__ = ["Landmark"]


class Landmark(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A landmark that sensors can identify; metres."""

    id: Count
    x: float
    y: float
