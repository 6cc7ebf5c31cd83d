"""What a scenario says of COLON: the capsule, its range finders, and the filters for pose and map."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.colon.end_radius import EndRadiusParams
from dynpf.colon.hypotheses import HypothesesParams
from dynpf.types import Count, NonNegative, Positive, Share

__all__ = [
    "CapsuleConfig",
    "CapsuleEstimatorConfig",
    "CapsuleSensorsConfig",
    "ClassicFilter",
    "EndRadiusFilter",
    "HypothesesFilter",
]


class CapsuleConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """A capsule that is driven along its route through the tube of the table ``[colon]``, a motion a tick.

    One that moves with noise is steered: each motion heads for the route's next place from where the capsule is.
    """

    sigma_px: NonNegative = 0.0  # px a motion, of x and of y
    sigma_theta: NonNegative = 0.0  # rad a motion


class CapsuleSensorsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """The capsule's five range finders, at -60, -30, 0, 30 and 60 degrees from its heading, capped at 500 px."""

    sigma_range_px: NonNegative = 0.0  # px
    outlier_fraction: Share = 0.0  # share of ranges that are anything up to the cap


class ClassicFilter(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="classic"
):
    """COLON's own filter, in the map that it is told of: 100 px, 0.1 px and 0.1 rad, resampling at each step."""

    n: Count = 100  # particles


class HypothesesFilter(HypothesesParams, frozen=True, kw_only=True, tag_field="kind", tag="hypotheses"):
    """The map is part of what is estimated: one of those listed, or none of these. Lengths are in px."""

    # Those listed; the first holds at the start.
    maps: Annotated[tuple[str, ...], Meta(min_length=1, max_length=63)] = ("a", "b")
    # What the filter makes of colon.told; obeyed: no map is estimated.
    schedule: Literal["ignored", "hint", "obeyed"] = "ignored"


class EndRadiusFilter(EndRadiusParams, frozen=True, kw_only=True, tag_field="kind", tag="end_radius"):
    """The map is a member of the family of tubes with a round end, of a radius that is estimated. Lengths are in px."""

    # Of the members that are drawn; between two, ranges go from one to the other.
    radii_px: Annotated[tuple[Positive, ...], Meta(min_length=2)] = tuple(float(radius) for radius in range(90, 166, 5))


class CapsuleEstimatorConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """A filter over the pose of a capsule in the tube of the table ``[colon]``, whose walls may change."""

    filter: ClassicFilter | HypothesesFilter | EndRadiusFilter = HypothesesFilter()
    start: Literal["known", "anywhere"] = "known"  # anywhere: the pose is searched for in the first map
