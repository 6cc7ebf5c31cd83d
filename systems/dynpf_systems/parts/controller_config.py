"""What a scenario says of the controller of PARTS; SI units and radians."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.types import Count, NonNegative, Positive, Rate

__all__ = ["RearrangementControllerConfig"]


class RearrangementControllerConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="rearrangement"
):
    """Potentials, pace, margins and events. Sigmas are those of the estimate."""

    # Potentials: lengths of ways around obstacles, or the products gamma^k / beta of PARTS.
    construction: Literal["navigation", "product"] = "navigation"
    next_exponent: Positive = 8.0  # k1 of PARTS eq. 2.1, of either construction
    mate_exponent: Positive = 8.0  # k2 and k3 of PARTS eq. 2.2 and 2.4, of the product
    move_exponent: Positive = 8.0

    closed: NonNegative = 0.002  # clearance below which there is no way, plus ...
    closed_sigmas: NonNegative = 2.5  # ... this many sigmas of robot and part together
    near: Positive = 0.04  # clearance beyond that, below which a way is longer than it is ...
    near_weight: NonNegative = 3.0  # ... by up to this share
    carrying_weight: Positive = 2.0  # of the way with the part against that to it, when choosing where to grip
    standoff: NonNegative = 0.02  # distance before contact at which the robot goes straight in, plus closed_sigmas
    dock_slack: NonNegative = 0.01  # it does so from this much farther off ...
    dock_angle: Positive = 0.15  # ... when it is no more than this aside
    blur_sigmas: NonNegative = 2.0  # of the bearing, by which a part may seem farther aside than it may be
    anew: Positive = 0.01  # a potential is solved anew when something has moved this far, plus ...
    anew_sigmas: NonNegative = 4.0  # ... this many of its sigmas
    parking_gaps: Annotated[tuple[Positive, ...], Meta(min_length=1)] = (0.2, 0.1, 0.05)  # around a part that makes way
    choice_ticks: Count = 10  # before it is asked again what can be done, when nothing could

    max_speed: Positive = 0.2  # m/s, of the robot, or of the part that it holds
    max_turn_rate: Positive = 2.0  # rad/s of the empty gripper
    max_carrying_turn_rate: Positive = 0.8  # rad/s with a part in it
    slow_distance: Positive = 0.03  # from a goal, where steps begin to shorten
    swing_arm: Positive = 0.5  # of the grip distance: weight of a turn against a step

    margin: NonNegative = 0.005  # clearance that is kept, plus ...
    margin_sigmas: NonNegative = 3.0  # ... this many sigmas of robot and part together
    max_sigma: Positive = 0.01  # a sigma counts for no more than this in a margin
    clearance_rate: Rate = 0.3  # share of a clearance beyond its margin that a tick may use up

    # The jaws close when the gap to the target exceeds neither the reach nor so many sigmas of robot and part together
    # by more than the slack: later, the robot might touch it; earlier, they pull it farther than need be.
    grip_sigmas: NonNegative = 3.0
    grip_slack: NonNegative = 0.003
    grip_angle: Positive = 0.05  # how far aside it may then be
    placed: NonNegative = 0.003  # distance from the goal at which a part is put down, plus ...
    placed_sigmas: NonNegative = 0.75
    reopened: NonNegative = 0.012  # distance at which a part is no longer home, plus ...
    reopened_sigmas: NonNegative = 3.5
    leave_gap: NonNegative = 0.03  # gap to a part just put down at which it is left, plus ...
    leave_sigmas: NonNegative = 2.5
    leave_ticks: Count = 3
    lost_sigma: Positive = 0.05  # a part known no better than this is waited for
    goal_gap: NonNegative = 0.005  # that a goal must have from the other parts to be free
    stall_ticks: Count = 60  # without progress, then another part is tried
    home_ticks: Count = 10  # with all parts home, then the task is finished
