"""Configuration of the controller of PARTS; SI units and radians."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynpf.types import Count, NonNegative, OpenShare, Positive, Rate

__all__ = ["RearrangementControllerConfig"]


class RearrangementControllerConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="rearrangement"
):
    """Potentials, pace, margins and events. Sigmas are standard deviations of the estimate."""

    # Potentials: path lengths around obstacles, or the products gamma^k / beta of PARTS.
    construction: Literal["navigation", "product"] = "navigation"
    next_exponent: Positive = 8.0  # k1 of PARTS eq. 2.1, of either construction
    mate_exponent: Positive = 8.0  # k2 and k3 of PARTS eq. 2.2 and 2.4, of the product
    move_exponent: Positive = 8.0

    closed: NonNegative = 0.002  # clearance below which a passage is closed, plus ...
    closed_sigmas: NonNegative = 2.5  # ... this many sigmas of robot and part together
    near: Positive = 0.04  # clearance beyond that, below which a path costs more than its length ...
    near_weight: NonNegative = 3.0  # ... by up to this factor of the length
    carrying_weight: Positive = 2.0  # of the path with the part relative to the path to it, in the choice of the grip
    standoff: NonNegative = 0.02  # distance before contact at which the robot goes straight in, plus closed_sigmas
    dock_slack: NonNegative = 0.01  # the same from this much farther away ...
    dock_angle: Positive = 0.15  # ... when the part is aside by at most this angle
    blur_sigmas: NonNegative = 2.0  # of the bearing, as tolerance of how far aside a part seems
    anew: Positive = 0.01  # a potential is solved again when something has moved this far, plus ...
    anew_sigmas: NonNegative = 4.0  # ... this many of its sigmas
    parking_gaps: Annotated[tuple[Positive, ...], Meta(min_length=1)] = (0.2, 0.1, 0.05)  # around a part that makes way
    choice_ticks: Count = 10  # between choices of a subtask while there is none

    max_speed: Positive = 0.2  # m/s, of the robot, or of the part that it holds
    max_turn_rate: Positive = 2.0  # rad/s of the empty gripper
    max_carrying_turn_rate: Positive = 0.8  # rad/s with a part in it
    slow_distance: Positive = 0.03  # from a goal, where steps begin to shorten
    swing_arm: Positive = 0.5  # of the grip distance: weight of a turn against a step

    margin: NonNegative = 0.005  # least clearance, plus ...
    margin_sigmas: NonNegative = 3.0  # ... this many sigmas of robot and part together
    max_sigma: Positive = 0.01  # upper limit of a sigma in margins
    clearance_rate: Rate = 0.3  # share of the clearance beyond its margin that a tick may use

    # The jaws close when the gap to the target exceeds the larger of the reach and these sigmas of robot and part
    # together by at most the slack: later, the robot might touch the part; earlier, the jaws pull it too far.
    grip_sigmas: NonNegative = 3.0
    grip_slack: NonNegative = 0.003
    grip_angle: Positive = 0.05  # rad, how far aside the part may be then
    placed: NonNegative = 0.003  # distance from the goal at which a part is put down, plus ...
    placed_sigmas: NonNegative = 0.75
    reopened: NonNegative = 0.012  # distance from the goal at which a part is no longer home, plus ...
    reopened_sigmas: NonNegative = 3.5
    leave_gap: NonNegative = 0.03  # gap at which the robot has left a part just put down, plus ...
    leave_sigmas: NonNegative = 2.5
    leave_ticks: Count = 3
    lost_sigma: Positive = 0.05  # m, a part whose position is less certain than this is waited for
    goal_gap: NonNegative = 0.005  # m, between a free goal and the other parts
    stall_ticks: Count = 60  # without progress, after which another part is tried
    home_ticks: Count = 10  # with all parts home, after which the task is finished

    sure: OpenShare = 0.9999  # probability of an identity below which a part is left alone, and the robot looks ...
    look_distance: NonNegative = 0.02  # ... moving by this, m, plus ...
    look_sigmas: NonNegative = 3.0  # ... this many sigmas of the robot ...
    look_ticks: Count = 10  # ... and standing still as long between two moves
    doubt_ticks: Count = 100  # with nothing left to do but parts of doubtful identity, after which the run ends
