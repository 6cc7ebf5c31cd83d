"""What a scenario says of PARTS: its world, and the filters for the robot and the parts; SI units and radians."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.types import Count, NonNegative, Positive, Share
from dynpf_systems.parts.camera_model import CameraParams
from dynpf_systems.parts.task import NOISE, Noise, RearrangementTask

__all__ = ["FilterName", "Hiding", "Intervention", "RearrangementConfig", "WorkspaceConfig"]

Index = Annotated[int, Meta(ge=0, lt=64)]

FilterName = Literal["optimal", "prior", "auxiliary", "local_linearization", "extended_kalman", "unscented_kalman"]

_STEADY, _SHARP = 1e-8, 2.5e-7  # m^2: noise that is left of a motion and of a detection without noise


class Intervention(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Someone puts a part elsewhere, out of the gripper if need be."""

    tick: Count
    part: Index  # its place in the task's list, from 0
    to: tuple[float, float]  # m


class Hiding(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something covers a part: neither the camera nor the overhead sensor sees it."""

    tick: Annotated[int, Meta(ge=0)]  # the first
    ticks: Count  # how many
    part: Index  # its place in the task's list, from 0


class WorkspaceConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="workspace"
):
    """A disc robot with a gripper among disc parts."""

    # m^2 a tick and coordinate, of the robot's motion; absent: that of the task's noise, 0.06 cm^2.
    process_variance: NonNegative | None = None
    grip_tolerance: NonNegative = 0.01  # gap beyond the reach at which the jaws still catch a part
    grip_angle: Positive = 0.2  # the same for the direction
    slip_probability: Share = 0.0  # that a part slips out of the jaws as they close on it ...
    slip_distance: NonNegative = 0.03  # ... this far ahead, if there is room
    interventions: tuple[Intervention, ...] = ()  # parts that someone moves
    hidings: tuple[Hiding, ...] = ()  # parts that something covers
    start_gap: NonNegative = 0.26  # between drawn starts: the robot fits between any two parts
    start_wall_gap: NonNegative = 0.10  # between drawn starts and the walls
    camera: CameraParams | None = None  # the overhead camera; absent: no frames are rendered


class RearrangementConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="rearrangement"
):
    """A filter for the robot, Kalman filters for the parts, and how detections are matched to them."""

    filter: FilterName = "optimal"  # the robot's: a particle filter with this proposal, or a Kalman filter
    n: Annotated[int, Meta(ge=1, le=1_000_000)] = 100  # particles, of a filter that has some
    # m^2, of the robot's motion, a tick and coordinate; absent: that of the task's noise, but at least (0.1 mm)^2.
    process_variance: NonNegative | None = None
    # m^2, of a detected centre, each coordinate; absent: that of the task's noise and (0.5 mm)^2 of the detection.
    measurement_variance: Positive | None = None
    part_process_variance: NonNegative = 1e-7  # of a part that nobody holds, a tick and coordinate
    encoder_variance: NonNegative = 1e-6  # rad^2, of the gripper's angle
    resampling_threshold: Share = 2.0 / 3.0  # N_eff below this share of n resamples
    gate: Positive = 20.0  # squared Mahalanobis distance beyond which a detection is another object's
    radius_sigma: Positive = 0.002
    radius_gate: Positive = 0.006  # metres
    robot_grey: float | None = None  # expected grey, less the background's; without it greys are learnt ...
    part_grey: float | None = None  # ... and at first only the radius tells which disc is which
    grey_sigma: Positive = 20.0
    prior_variance: Positive = 1.0  # of a position that nothing is known about
    lost_after: Count = 20  # detections in which an object is missing, then its position is forgotten
    particle_period_s: NonNegative = 0.2  # logical time between particle clouds

    def noise(self, task: RearrangementTask) -> Noise:
        """Return what noise the filters expect."""
        process, measurement = NOISE[task.noise]
        return Noise(
            max(process, _STEADY) if self.process_variance is None else self.process_variance,
            measurement + _SHARP if self.measurement_variance is None else self.measurement_variance,
        )
