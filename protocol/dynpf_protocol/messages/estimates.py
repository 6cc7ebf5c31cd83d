"""Estimates of a robot's pose, and their health."""

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from dynpf_protocol.messages.base import Angle, Count, Message, NonNegative, Piece

__all__ = [
    "Estimate",
    "FilterHealth",
    "HealthFigures",
]


class HealthFigures(Piece, frozen=True, kw_only=True):
    """The numbers behind a filter's health; unknown or infinite ones are left out."""

    position_sigma: float | UnsetType = UNSET  # m, in the direction in which it is greatest
    heading_sigma: float | UnsetType = UNSET  # rad
    mode_mass: float | UnsetType = UNSET  # share of the weight in the heaviest mode
    n_eff_share: float | UnsetType = UNSET  # effective particles as a share of all
    log_likelihood: float | UnsetType = UNSET  # of one reading, natural logarithm, short-term average
    likelihood_ratio: float | UnsetType = UNSET  # short-term over long-term average
    refused_share: float | UnsetType = UNSET  # of the recent readings
    impossible: Count = 0  # updates in a row that no particle explains


class FilterHealth(Piece, frozen=True, kw_only=True):
    """How reliable an estimate is, and why."""

    status: Literal["tracking", "uncertain", "lost", "kidnapped", "map_does_not_fit"]
    reason: str
    figures: HealthFigures


class Estimate(Message, frozen=True, kw_only=True):
    """The pose estimate: weighted mean with circular heading, covariance of (x, y, theta) row by row, and health."""

    schema_name = "dynpf.Estimate"
    x: float  # m
    y: float  # m
    theta: Angle  # rad
    covariance: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]  # m^2, m rad, rad^2
    n_eff: NonNegative  # effective sample size
    health: FilterHealth | UnsetType = UNSET  # left out by an estimator that does not monitor its health
