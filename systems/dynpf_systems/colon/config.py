"""Configuration of COLON: the capsule, its range finders, and the filters for pose and map."""

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
    """A capsule driven along its route through the tube of the table ``[colon]``, one motion each tick.

    With motion noise it is steered: each motion heads from the capsule's true pose for the next pose of the route.
    """

    sigma_px: NonNegative = 0.0  # px for each motion, of x and of y
    sigma_theta: NonNegative = 0.0  # rad for each motion


class CapsuleSensorsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """The capsule's five range finders, at -60, -30, 0, 30 and 60 degrees from its heading, capped at 500 px."""

    sigma_range_px: NonNegative = 0.0  # px
    outlier_fraction: Share = 0.0  # share of ranges that are uniform up to the cap


class ClassicFilter(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="classic"
):
    """COLON's own filter, in the map given by ``told``: 100 px, 0.1 px and 0.1 rad, resampling at each step."""

    n: Count = 100  # particles


class HypothesesFilter(HypothesesParams, frozen=True, kw_only=True, tag_field="kind", tag="hypotheses"):
    """A filter that estimates the map, too: one of those listed, or none of these. Lengths are in px."""

    # The maps listed; the first holds at the start.
    maps: Annotated[tuple[str, ...], Meta(min_length=1, max_length=63)] = ("a", "b")
    # How the filter uses colon.told; obeyed: no map is estimated.
    schedule: Literal["ignored", "hint", "obeyed"] = "ignored"


class EndRadiusFilter(EndRadiusParams, frozen=True, kw_only=True, tag_field="kind", tag="end_radius"):
    """A filter that estimates the radius of the tube's round end, in a family of maps. Lengths are in px."""

    # Radii of the maps drawn; ranges are interpolated between two of them.
    radii_px: Annotated[tuple[Positive, ...], Meta(min_length=2)] = tuple(float(radius) for radius in range(90, 166, 5))


class CapsuleEstimatorConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """A filter over the pose of a capsule in the tube of the table ``[colon]``, whose walls may change."""

    filter: ClassicFilter | HypothesesFilter | EndRadiusFilter = HypothesesFilter()
    start: Literal["known", "anywhere"] = "known"  # anywhere: uniform in the first map
