"""The scenario that filters laser logs as AMCL's parameters say, and a row for each parameter that tells its fate."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from dynpf_services.scenario.overrides import toml_value

from dynpf.portable import erf
from dynpf_systems.rooms.amcl.parameters import NAMES
from dynpf_systems.rooms.amcl.reading import Parameters

__all__ = ["Row", "is_start_given", "ranges_of", "rows_of", "scenario_of", "toml_of"]

FARTHEST = 100.0
"""laser_max_range where nobody says it, m: no scanner of a robot sees as far."""

Table = dict[str, Any]


class Row(NamedTuple):
    """What becomes of a parameter, in words."""

    parameter: str  # as the file calls it
    value: str
    becomes: str


def scenario_of(parameters: Parameters, source: str) -> Table:
    """Return the scenario of these parameters, of the file ``source``, as the tables of a scenario file."""
    values = parameters.values
    estimator: Table = {
        "kind": "localization",
        "n": values["max_particles"],
        "start": _start(parameters),
        "min_travel": values["update_min_d"],
        "min_turn": values["update_min_a"],
        **ranges_of(parameters),
        "motion": {"kind": "odometry", **{f"alpha_{i}": values[f"alpha{i}"] for i in range(1, 5)}},
        "measurement": [_measurement(values)],
        "resampling": {"kind": "multinomial", "when": _resampled(values), "only_when_moving": True},
        "adaptation": [_kld(values), *_recovery(values)],
    }
    title = f"Particle filter on a robot's log, with AMCL's parameters of {source}"
    return {"title": title, "needs_log": True, "sensors": {"kind": "log"}, "estimator": estimator}


def ranges_of(parameters: Parameters) -> Table:
    """Return the limits of a scan's ranges that the parameters set, m."""
    least, greatest = parameters.values["laser_min_range"], parameters.values["laser_max_range"]
    found = {} if least <= 0.0 else {"scan_range_min": least}
    return found if not 0.0 < greatest < FARTHEST else {**found, "scan_range_max": greatest}


def _start(parameters: Parameters) -> Table:
    values = parameters.values
    variance = 0.5 * (values["initial_cov_xx"] + values["initial_cov_yy"])
    sigmas = {"sigma_position": math.sqrt(variance), "sigma_heading": math.sqrt(values["initial_cov_aa"])}
    if not is_start_given(parameters):
        return {"kind": "known", **sigmas}
    pose = {"x": values["initial_pose.x"], "y": values["initial_pose.y"], "theta": values["initial_pose.yaw"]}
    return {"kind": "known", **pose, **sigmas}


def is_start_given(parameters: Parameters) -> bool:
    """Return whether the file says where the robot starts: in Nav2 set_initial_pose must be true, too."""
    posed = any(name in parameters.given for name in ("initial_pose.x", "initial_pose.y", "initial_pose.yaw"))
    return posed if parameters.ros1 else bool(parameters.values["set_initial_pose"])


def _measurement(values: Mapping[str, Any]) -> Table:
    sigma = values["sigma_hit"]
    height = math.sqrt(2.0 * math.pi) * sigma  # of AMCL's bell over that of a normalized one
    common: Table = {"sigma_hit": sigma, "max_beams": values["max_beams"]}
    if values["laser_model_type"] == "beam":
        shares = {name: values[name] for name in ("z_short", "z_max", "z_rand")} | {"z_hit": values["z_hit"] * height}
        total = math.fsum(shares.values())
        shares = {name: share / total for name, share in shares.items()}
        return {"kind": "beam", **shares, **common, "lambda_short": values["lambda_short"], "tempering": 0.2}
    # The shares are no more than 1; above that only their ratio can be kept.
    scale = 1.0 / max(values["z_hit"] * height, values["z_rand"], 1.0)
    field: Table = {
        "kind": "likelihood_field",
        "z_hit": max(values["z_hit"] * height * scale, 1e-12),
        "z_rand": max(values["z_rand"] * scale, 1e-12),
        **common,
        "max_distance": values["laser_likelihood_max_dist"],
        "aggregation": "cubes" if values["laser_model_type"] == "likelihood_field" else "product",
    }
    if _skips(values):
        field["beam_skip"] = {
            "distance": values["beam_skip_distance"],
            "agreement": values["beam_skip_threshold"],
            "most": values["beam_skip_error_threshold"],
        }
    return field


def _skips(values: Mapping[str, Any]) -> bool:
    return bool(values["do_beamskip"]) and values["laser_model_type"] == "likelihood_field_prob"


def _resampled(values: Mapping[str, Any]) -> str:
    return "n_eff" if values["resample_interval"] > 1 or values["selective_resampling"] else "always"


def _kld(values: Mapping[str, Any]) -> Table:
    return {
        "kind": "kld",
        "epsilon": values["pf_err"],
        "probability": _probability(values["pf_z"]),
        "n_min": values["min_particles"],
        "n_max": values["max_particles"],
    }


def _probability(quantile: float) -> float:
    """Return the probability of a quantile of the normal distribution, below 1."""
    return min(0.5 * (1.0 + erf(quantile / math.sqrt(2.0))), 1.0 - 1e-9)


def _recovery(values: Mapping[str, Any]) -> list[Table]:
    slow, fast = values["recovery_alpha_slow"], values["recovery_alpha_fast"]
    return [{"kind": "augmented", "alpha_slow": slow, "alpha_fast": fast}] if slow > 0.0 and fast > 0.0 else []


def rows_of(parameters: Parameters) -> list[Row]:
    """Return a row for each parameter that the file gives, in its order, then for those that are unknown."""
    special = _special(parameters)
    rows = [
        Row(given.name, given.text, special.get(name, NAMES[name].fate)) for name, given in parameters.given.items()
    ]
    unknown = (
        Row(given.name, given.text, f"left out: AMCL has no such parameter{'; ' + hint if hint else ''}")
        for given, hint in parameters.unknown
    )
    return [row._replace(becomes=row.becomes.replace("`", "")) for row in (*rows, *unknown)]


def _special(parameters: Parameters) -> dict[str, str]:
    """Return what becomes of parameters where it depends on others, or on their value."""
    values = parameters.values
    model = values["laser_model_type"]
    found: dict[str, str] = {}
    if model != "beam":
        found |= dict.fromkeys(("z_short", "z_max", "lambda_short"), f"left out: only beam has it, this is {model}")
    else:
        found["laser_likelihood_max_dist"] = "left out: beam has no such distance"
    measurement = _measurement(values)
    for name in ("z_hit", "z_rand", *(("z_short", "z_max") if model == "beam" else ())):
        found[name] = f"estimator.measurement.{name} = {measurement[name]:.4g}, {_why(name, model)}"
    if not _skips(values):
        why = f"{model} has none" if values["do_beamskip"] else "do_beamskip is not true"
        skipping = ("do_beamskip", "beam_skip_distance", "beam_skip_threshold", "beam_skip_error_threshold")
        found |= dict.fromkeys(skipping, f"left out: {why}")
    if not is_start_given(parameters):
        why = "left out: set_initial_pose is not true"
        found |= dict.fromkeys(("initial_pose.x", "initial_pose.y", "initial_pose.yaw"), why)
    if not _recovery(values):
        found |= dict.fromkeys(
            ("recovery_alpha_slow", "recovery_alpha_fast"), "left out: 0 of either means no recovery"
        )
    limits = ranges_of(parameters)
    for name, key in (("laser_min_range", "scan_range_min"), ("laser_max_range", "scan_range_max")):
        found[name] = NAMES[name].fate if key in limits else "left out: the scanner's own limit holds"
    found["alpha5"] = "left out: only AMCL's omnidirectional model has it"
    found["pf_z"] = f"probability = {_probability(values['pf_z']):.4g} of the adaptation kld: AMCL's pf_z is a quantile"
    return found


def _why(name: str, model: str) -> str:
    if model == "beam":
        return "so that the four shares sum to 1"
    return "since AMCL's bell is not normalized" if name == "z_hit" else "on the same scale as z_hit"


def toml_of(scenario: Table) -> str:
    """Return a scenario file's text: scalars of the run, then its tables, with one-line tables within."""
    lines = [f"{key} = {toml_value(key, value)}" for key, value in scenario.items() if not isinstance(value, dict)]
    for name, table in scenario.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *_lines(name, table)]
    return "\n".join(lines) + "\n"


def _lines(path: str, table: Table) -> list[str]:
    inner = {key: value for key, value in table.items() if key != "start" and isinstance(value, dict | list)}
    lines = [f"{key} = {toml_value(key, value)}" for key, value in table.items() if key not in inner]
    for key, value in inner.items():
        head = f"[[{path}.{key}]]" if isinstance(value, list) else f"[{path}.{key}]"
        for part in value if isinstance(value, list) else [value]:
            lines += ["", head, *(f"{name} = {toml_value(name, found)}" for name, found in part.items())]
    return lines
