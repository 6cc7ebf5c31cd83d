"""Configuration of PARTS: its world, and the filters for the robot and the parts; SI units and radians."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.types import Count, NonNegative, OpenShare, Positive, Share
from dynpf_systems.parts.camera_model import CameraParams
from dynpf_systems.parts.task import Index, Noise, RearrangementTask

__all__ = ["FilterName", "Hiding", "IdentityConfig", "Intervention", "RearrangementConfig", "WorkspaceConfig"]

FilterName = Literal["optimal", "prior", "auxiliary", "local_linearization", "extended_kalman", "unscented_kalman"]

_STEADY, _SHARP = 1e-8, 2.5e-7  # m^2: least process noise, and noise of the disc detection itself


class Intervention(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Someone moves a part to another position, out of the gripper if need be."""

    tick: Count
    part: Index  # its index in the task's list
    to: tuple[float, float]  # m


class Hiding(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something covers a part: neither the camera nor the overhead sensor sees it."""

    tick: Annotated[int, Meta(ge=0)]  # the first
    ticks: Count  # how many
    part: Index  # its index in the task's list


class WorkspaceConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="workspace"
):
    """A disc robot with a gripper among disc parts."""

    # m^2 for each tick and coordinate of the robot's motion; absent: that of the task's noise, 0.06 cm^2.
    process_variance: NonNegative | None = None
    grip_tolerance: NonNegative = 0.01  # gap beyond the reach at which the jaws still catch a part
    grip_angle: Positive = 0.2  # rad, the same for the direction
    slip_probability: Share = 0.0  # of a part that slips out of the jaws as they close on it ...
    slip_distance: NonNegative = 0.03  # ... this far ahead, if there is room
    interventions: tuple[Intervention, ...] = ()  # parts that someone moves
    hidings: tuple[Hiding, ...] = ()  # parts that something covers
    start_gap: NonNegative = 0.26  # between drawn starts, so that the robot fits between any two parts
    start_wall_gap: NonNegative = 0.10  # between drawn starts and the walls
    camera: CameraParams | None = None  # the overhead camera; absent: no frames are rendered


class IdentityConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How discs that look alike are told apart."""

    radius_bias: Positive = 0.00025  # m, standard deviation of what stays wrong in a disc's radius however often seen
    colour_sigma: Positive = 20.0  # levels of blue, green and red, of a disc's colour in any light
    grey_sigmas: Positive = 3.0  # from so many grey_sigma on the given greys of robot and parts tell them apart
    start_sigma: Positive = 0.03  # m, of a start that the task gives, and of the place where a lost part turns up again
    moved: OpenShare = 0.01  # probability that one is somewhere else instead
    sure: OpenShare = 0.9999  # probability of an identity from which on others are not considered any more
    relabel: NonNegative = 2.0  # nats by which another hypothesis has to be better to take the place of the present one


class RearrangementConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="rearrangement"
):
    """A filter for the robot, Kalman filters for the parts, and the association of detections with them."""

    filter: FilterName = "optimal"  # the robot's: a particle filter with this proposal, or a Kalman filter
    n: Annotated[int, Meta(ge=1, le=1_000_000)] = 100  # particles, of a particle filter
    # m^2 for each tick and coordinate of the robot's motion; absent: that of the task's noise, at least (0.1 mm)^2.
    process_variance: NonNegative | None = None
    # m^2 for each coordinate of a detected centre; absent: that of the task's noise plus (0.5 mm)^2 of the detection.
    measurement_variance: Positive | None = None
    part_process_variance: NonNegative = 1e-7  # m^2 for each tick and coordinate of a part that is not held
    encoder_variance: NonNegative = 1e-6  # rad^2, of the gripper's angle
    resampling_threshold: Share = 2.0 / 3.0  # N_eff below this share of n resamples
    gate: Positive = 20.0  # squared Mahalanobis distance above which a detection is not associated
    radius_sigma: Positive = 0.002
    radius_gate: Positive = 0.006  # metres
    robot_grey: float | None = None  # expected grey minus the background's; absent: greys are learnt ...
    part_grey: float | None = None  # ... and at first only radii distinguish the discs
    grey_sigma: Positive = 20.0
    miss_cost: float = 3.5  # nats: minus the log-likelihood ratio of missing a disc and having a false one
    identity: IdentityConfig = IdentityConfig()
    prior_variance: Positive = 1.0  # m^2, of an unknown position
    lost_after: Count = 20  # consecutive detections without an object after which its position counts as unknown
    particle_period_s: NonNegative = 0.2  # logical time between published clouds

    def noise(self, task: RearrangementTask) -> Noise:
        """Return the noise variances that the filters assume."""
        process, measurement = task.variances
        return Noise(
            max(process, _STEADY) if self.process_variance is None else self.process_variance,
            measurement + _SHARP if self.measurement_variance is None else self.measurement_variance,
        )
