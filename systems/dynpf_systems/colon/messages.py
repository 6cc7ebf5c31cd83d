"""Messages of COLON: a capsule in its tube, in pixels of its maps."""

from typing import Annotated

from dynpf_protocol.messages.base import Angle, Count, Message, NonNegative, Piece
from msgspec import UNSET, Meta, UnsetType

__all__ = [
    "CapsuleEstimate",
    "CapsuleMove",
    "CapsuleReading",
    "CapsuleState",
    "MapProbability",
    "MovedWall",
]


class CapsuleMove(Piece, frozen=True, kw_only=True):
    """A motion: a turn, followed by a straight path."""

    rho_px: float  # px
    turn: Angle  # rad


class CapsuleState(Message, frozen=True, kw_only=True):
    """The true pose of the capsule in its tube at a reading, and the name of the true map."""

    schema_name = "dynpf.CapsuleState"
    reading: Count  # its number: 0 at the start, then one for each motion
    x_px: float  # px
    y_px: float  # px
    theta: Angle  # rad
    map: str
    move: CapsuleMove | UnsetType = UNSET  # that it was told to make since the reading before; left out at the start


class CapsuleReading(Message, frozen=True, kw_only=True):
    """The ranges of a capsule in a tube after a motion."""

    schema_name = "dynpf.CapsuleReading"
    reading: Count  # its number: 0 at the start, then one for each motion
    ranges_px: Annotated[
        tuple[NonNegative, ...], Meta(min_length=5, max_length=5)
    ]  # px, at -60, -30, 0, 30, 60 degrees
    move: CapsuleMove | UnsetType = UNSET  # that it was told to make since the reading before; left out at the start


class MapProbability(Piece, frozen=True, kw_only=True):
    """The posterior probability of a map."""

    map: str  # its name, or "none of these"
    probability: Annotated[float, Meta(ge=0.0, le=1.0)]


class MovedWall(Piece, frozen=True, kw_only=True):
    """A point on the wall of the reference map, and its outward displacement."""

    x_px: float  # px
    y_px: float  # px
    moved_px: float  # px


class CapsuleEstimate(Message, frozen=True, kw_only=True):
    """The estimated pose of the capsule, and the map of its tube that holds."""

    schema_name = "dynpf.CapsuleEstimate"
    reading: Count  # that it follows
    x_px: float  # px
    y_px: float  # px
    theta: Angle  # rad
    covariance: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]  # px^2, px rad, rad^2, row by row
    n_eff: NonNegative  # effective sample size
    map: str  # the likeliest; without estimation of maps that of the schedule; of estimated radii the nearest
    maps: Annotated[tuple[MapProbability, ...], Meta(max_length=64)] = ()  # posterior; empty: no map is estimated
    changed_at: NonNegative | UnsetType = UNSET  # expected number of the reading from which on ``map`` holds
    reference: str | UnsetType = UNSET  # the map that ``walls`` have moved from
    walls: Annotated[tuple[MovedWall, ...], Meta(max_length=10_000)] = ()  # what explains "none of these"; else empty
    end_radius_px: NonNegative | UnsetType = UNSET  # px, from a filter that estimates it
    end_radius_sigma_px: NonNegative | UnsetType = UNSET  # px
