"""All parameters of AMCL: what each may be, what it is where nobody says, and what becomes of it here.

Names are those of nav2_amcl; ``ROS1_NAMES`` gives those of amcl in ROS 1 that differ.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from dynpf.maps.yaml_text import number

__all__ = ["NAMES", "PARAMETERS", "ROS1_NAMES", "Parameter", "is_used"]


class Parameter(NamedTuple):
    """A parameter: ``taken`` returns a value of it, or None for one that is not ``expected``."""

    name: str
    taken: Callable[[Any], Any]
    expected: str
    default: Any  # of nav2_amcl
    ros1: Any  # default of amcl in ROS 1
    fate: str  # what becomes of it


def _range(low: float, high: float = math.inf) -> tuple[Callable[[Any], float | None], str]:
    def taken(value: Any) -> float | None:
        found = number(value)
        return found if found is not None and low <= found <= high else None

    above = "a finite number" if low == -math.inf else f"a finite number, {low:g} or more"
    return taken, above if high == math.inf else f"a number from {low:g} to {high:g}"


def _above(low: float) -> tuple[Callable[[Any], float | None], str]:
    def taken(value: Any) -> float | None:
        found = number(value)
        return found if found is not None and found > low else None

    return taken, f"a finite number above {low:g}"


def _count(least: int, most: int) -> tuple[Callable[[Any], int | None], str]:
    def taken(value: Any) -> int | None:
        found = number(value)
        return int(found) if found is not None and found.is_integer() and least <= found <= most else None

    return taken, f"a whole number from {least} to {most}"


def _limit(value: Any) -> float | None:
    """Return a range in metres, or -1 for that of the scanner."""
    found = number(value)
    return found if found is not None and (found >= 0.0 or found == -1.0) else None


def _flag(value: Any) -> bool | None:
    return value if isinstance(value, bool) else {"true": True, "false": False}.get(str(value).lower())


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and len(value) <= 256 else None


def _one_of(*names: str) -> tuple[Callable[[Any], str | None], str]:
    return lambda value: value if isinstance(value, str) and value in names else None, f"one of {', '.join(names)}"


_ANY = _range(-math.inf)
_VARIANCE = _range(0.0)
_SHARE = _range(0.0, 1.0)
_FLAG = (_flag, "true or false")
_TEXT = (_text, "a text of at most 256 characters")
_LIMIT = (_limit, "metres, 0 or more, or -1 for the scanner's own")
_MOTION = _one_of(
    "differential",
    "omnidirectional",
    "nav2_amcl::DifferentialMotionModel",
    "nav2_amcl::OmniMotionModel",
    "diff",
    "omni",
    "diff-corrected",
    "omni-corrected",
)
_QUARTER_METRE = 0.25
_FIFTEEN_DEGREES_SQUARED = (math.pi / 12.0) ** 2
_PUBLISHED = "left out: dynpf publishes the pose with every step"
_FRAME = "left out: a recording has one robot, one map"
_HINT = "`dynpf localize` takes it where the bag has it; an imported log has one already"
_NODE = "left out: it concerns the process of ROS, not the filter"
_ALPHA = "of each record of odometry, not of each update: n records to an update add up to an n-th of AMCL's variance"

PARAMETERS = (
    Parameter("alpha1", *_VARIANCE, 0.2, 0.2, f"`estimator.motion.alpha_1`; {_ALPHA}"),
    Parameter("alpha2", *_VARIANCE, 0.2, 0.2, "`estimator.motion.alpha_2`, likewise"),
    Parameter("alpha3", *_VARIANCE, 0.2, 0.2, "`estimator.motion.alpha_3`, likewise"),
    Parameter("alpha4", *_VARIANCE, 0.2, 0.2, "`estimator.motion.alpha_4`, likewise"),
    Parameter("alpha5", *_VARIANCE, 0.2, 0.2, "left out: only the omnidirectional model has it"),
    Parameter(
        "robot_model_type",
        *_MOTION,
        "nav2_amcl::DifferentialMotionModel",
        "diff",
        '`estimator.motion.kind = "odometry"`, which moves sideways by turning, going and turning back; diff of '
        "ROS 1 (not diff-corrected) has less noise, taking the variance for the standard deviation",
    ),
    Parameter(
        "laser_model_type",
        *_one_of("beam", "likelihood_field", "likelihood_field_prob"),
        "likelihood_field",
        "likelihood_field",
        '`estimator.measurement.kind`; likelihood_field has `aggregation = "cubes"`, likelihood_field_prob '
        '`"product"`, beam a product with `tempering = 0.2`, where AMCL adds up cubes',
    ),
    Parameter(
        "z_hit",
        *_SHARE,
        0.5,
        0.95,
        "`estimator.measurement.z_hit`, times sqrt(2 pi) sigma_hit: AMCL's bell is not normalized, ours is; of the "
        "beam model divided by the sum of the four shares",
    ),
    Parameter("z_short", *_SHARE, 0.05, 0.1, "`estimator.measurement.z_short`, of the beam model; else left out"),
    Parameter("z_max", *_SHARE, 0.05, 0.05, "`estimator.measurement.z_max`, of the beam model; else left out"),
    Parameter("z_rand", *_SHARE, 0.5, 0.05, "`estimator.measurement.z_rand`"),
    Parameter("sigma_hit", *_above(0.0), 0.2, 0.2, "`estimator.measurement.sigma_hit`"),
    Parameter(
        "lambda_short", *_above(0.0), 0.1, 0.1, "`estimator.measurement.lambda_short`, of the beam model; else left out"
    ),
    Parameter("max_beams", *_count(2, 100_000), 60, 30, "`estimator.measurement.max_beams`"),
    Parameter(
        "laser_likelihood_max_dist",
        *_above(0.0),
        2.0,
        2.0,
        "`estimator.measurement.max_distance`, of the likelihood fields; else left out",
    ),
    Parameter(
        "laser_min_range", *_LIMIT, -1.0, -1.0, "`estimator.scan_range_min`; -1 leaves the scanner's own, as in AMCL"
    ),
    Parameter(
        "laser_max_range",
        *_LIMIT,
        100.0,
        -1.0,
        "`estimator.scan_range_max`, where it is less than 100: AMCL takes the lesser of it and the scanner's own. It "
        "must be no more than the scanner's; `dynpf localize` sees to that",
    ),
    Parameter("min_particles", *_count(1, 1_000_000), 500, 100, "`n_min` of the adaptation `kld`"),
    Parameter(
        "max_particles",
        *_count(1, 1_000_000),
        2000,
        5000,
        "`n_max` of the adaptation `kld`, and `estimator.n` at first",
    ),
    Parameter("pf_err", *_above(0.0), 0.05, 0.01, "`epsilon` of the adaptation `kld`"),
    Parameter(
        "pf_z",
        *_above(0.0),
        0.99,
        0.99,
        "`probability` of the adaptation `kld`: AMCL takes it as a quantile of the normal distribution, 0.99 for 0.839",
    ),
    Parameter("update_min_d", *_VARIANCE, 0.25, 0.2, "`estimator.min_travel`"),
    Parameter("update_min_a", *_VARIANCE, 0.2, math.pi / 6.0, "`estimator.min_turn`"),
    Parameter(
        "resample_interval",
        *_count(1, 1_000_000),
        1,
        2,
        "`estimator.resampling.when`: 1 is always, more is n_eff, that is where few particles carry the weight",
    ),
    Parameter(
        "recovery_alpha_slow",
        *_SHARE,
        0.0,
        0.0,
        "`alpha_slow` of the adaptation `augmented`; 0, or the fast one 0, leaves that out, as in AMCL",
    ),
    Parameter("recovery_alpha_fast", *_SHARE, 0.0, 0.0, "`alpha_fast` of the adaptation `augmented`"),
    Parameter(
        "set_initial_pose",
        *_FLAG,
        False,
        None,
        "true: `estimator.start` is initial_pose; false: it is the log's first reference pose, if the log has one",
    ),
    Parameter("initial_pose.x", *_ANY, 0.0, 0.0, "`estimator.start.x`"),
    Parameter("initial_pose.y", *_ANY, 0.0, 0.0, "`estimator.start.y`"),
    Parameter("initial_pose.z", *_ANY, 0.0, None, "left out: the robot moves in a plane"),
    Parameter("initial_pose.yaw", *_ANY, 0.0, 0.0, "`estimator.start.theta`"),
    Parameter(
        "initial_cov_xx",
        *_VARIANCE,
        _QUARTER_METRE,
        _QUARTER_METRE,
        "`estimator.start.sigma_position`, whose square is the mean of xx and yy",
    ),
    Parameter("initial_cov_yy", *_VARIANCE, _QUARTER_METRE, _QUARTER_METRE, "as initial_cov_xx"),
    Parameter(
        "initial_cov_aa",
        *_VARIANCE,
        _FIFTEEN_DEGREES_SQUARED,
        _FIFTEEN_DEGREES_SQUARED,
        "`estimator.start.sigma_heading`, squared",
    ),
    Parameter("do_beamskip", *_FLAG, False, False, "`estimator.measurement.beam_skip`, of likelihood_field_prob"),
    Parameter("beam_skip_distance", *_above(0.0), 0.5, 0.5, "`beam_skip.distance`"),
    Parameter("beam_skip_threshold", *_SHARE, 0.3, 0.3, "`beam_skip.agreement`"),
    Parameter("beam_skip_error_threshold", *_SHARE, 0.9, 0.9, "`beam_skip.most`"),
    Parameter("scan_topic", *_TEXT, "scan", None, f"the scan: {_HINT}"),
    Parameter("base_frame_id", *_TEXT, "base_footprint", "base_link", _FRAME),
    Parameter("odom_frame_id", *_TEXT, "odom", "odom", _FRAME),
    Parameter("global_frame_id", *_TEXT, "map", "map", _FRAME),
    Parameter("map_topic", *_TEXT, "map", None, _FRAME),
    Parameter("use_map_topic", *_FLAG, None, False, _FRAME),
    Parameter("first_map_only", *_FLAG, False, False, _FRAME),
    Parameter(
        "transform_tolerance",
        *_ANY,
        1.0,
        0.1,
        "left out: a log is not waited for; every reading has the pose of its stamp",
    ),
    Parameter("tf_broadcast", *_FLAG, True, True, _PUBLISHED),
    Parameter(
        "save_pose_rate", *_ANY, 0.5, 0.5, "left out: the recording has every pose, `dynpf localize` keeps the last"
    ),
    Parameter("gui_publish_rate", *_ANY, None, -1.0, "left out: particles are published five times a second"),
    Parameter(
        "always_reset_initial_pose", *_FLAG, False, None, "left out: each run begins anew; `dynpf localize --start`"
    ),
    Parameter(
        "selective_resampling",
        *_FLAG,
        None,
        False,
        "`estimator.resampling.when`: true is n_eff, that is where few particles carry the weight",
    ),
    Parameter(
        "freespace_downsampling", *_FLAG, False, None, "left out: new particles are drawn from all of the free space"
    ),
    Parameter("random_seed", *_ANY, None, None, "left out: the seed is `--seed`, and the same bytes come of it"),
    Parameter("use_sim_time", *_FLAG, False, False, _NODE),
    Parameter("bond_heartbeat_period", *_ANY, 0.1, None, _NODE),
    Parameter("autostart_node", *_FLAG, None, None, _NODE),
    Parameter("introspection_mode", *_TEXT, "disabled", None, _NODE),
    Parameter("service_introspection_mode", *_TEXT, "disabled", None, _NODE),
    Parameter("allow_parameter_qos_overrides", *_FLAG, True, None, _NODE),
    Parameter("force_update_after_initialpose", *_FLAG, None, False, "left out: the first reading always updates"),
    Parameter("force_update_after_set_map", *_FLAG, None, False, "left out: the first reading always updates"),
    Parameter("restore_defaults", *_FLAG, None, False, _NODE),
)

NAMES = {parameter.name: parameter for parameter in PARAMETERS}

ROS1_NAMES = {
    **{f"odom_alpha{i}": f"alpha{i}" for i in range(1, 6)},
    "odom_model_type": "robot_model_type",
    **{
        f"laser_{name}": name
        for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short", "max_beams")
    },
    "kld_err": "pf_err",
    "kld_z": "pf_z",
    "initial_pose_x": "initial_pose.x",
    "initial_pose_y": "initial_pose.y",
    "initial_pose_a": "initial_pose.yaw",
}
"""The names of ROS 1 that differ, and ours for them."""


def is_used(name: str) -> bool:
    """Return whether a parameter, by nav2's name, makes something of the scenario."""
    return "estimator." in NAMES[name].fate or "adaptation" in NAMES[name].fate or "beam_skip" in NAMES[name].fate
