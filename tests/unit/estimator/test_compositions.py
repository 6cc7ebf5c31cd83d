"""Every component that a scenario can name runs in the estimator, in a closed loop with a simulated robot."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import Estimate
from dynpf_runtime.graph import Graph
from dynpf_runtime.replay import replay_node
from dynpf_services.scenario.build import build_nodes, plan_of
from dynpf_services.scenario.load import parse_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario, resolved_json
from dynpf_services.scenario.user_component import UserComponent
from dynpf_systems.rooms.localization.config import LocalizationConfig

TICKS = 8
RANGE_BEARING = {"kind": "range_bearing"}
IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
NOISE = [[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]]

COMPOSITIONS: dict[str, dict[str, Any]] = {
    "arcs": {"motion": "arcs"},
    "calibration": {"motion": "arcs", "calibration": {}},
    "velocity": {"motion": "velocity"},
    "odometry": {"motion": "odometry"},
    "capsule_step": {"motion": {"kind": "capsule_step", "sigma": 0.02, "sigma_theta": 0.02}},
    "linear_gaussian": {"motion": {"kind": "linear_gaussian", "transition": IDENTITY, "noise": NOISE}},
    "linear_gaussian_input": {
        "motion": {
            "kind": "linear_gaussian",
            "transition": IDENTITY,
            "noise": NOISE,
            "input": [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]],
        }
    },
    "gradient_flow": {
        "motion": {
            "kind": "gradient_flow",
            "variance": 1e-4,
            "turn_variance": 1e-3,
            "field": {"goal": [0.5, 0.8], "speed": 0.3, "discs": [[0.0, 0.2, 0.1]]},
        }
    },
    "range_bearing": {"measurement": "range_bearing"},
    "unknown_landmarks": {"measurement": "unknown_landmarks"},
    "likelihood_field": {"measurement": "likelihood_field"},
    "beam": {"measurement": "beam"},
    "range_vector": {
        "measurement": {"kind": "range_vector", "angles": [-1.0, -0.5, 0.0, 0.5, 1.0], "range_max": 4.0, "sigma": 0.3}
    },
    "polar_lines": {"measurement": "polar_lines"},
    "scan_lines": {
        "measurement": {"kind": "scan_lines", "extraction": {"min_points": 2, "gap": 4.0}, "lines": {"sigma_rho": 0.3}}
    },
    "position": {"measurement": {"kind": "position", "sigma": 0.2}},
    "fused": {"measurement": ["range_bearing", "likelihood_field", "polar_lines", "position"]},
    "systematic": {"resampling": {"kind": "systematic", "when": "always"}},
    "stratified": {"resampling": {"kind": "stratified", "when": "always"}},
    "residual": {"resampling": {"kind": "residual", "when": "always", "only_when_moving": True}},
    "multinomial": {"resampling": {"kind": "multinomial", "threshold": 0.9}},
    "prior": {"proposal": "prior"},
    "optimal": {"proposal": "optimal"},
    "local_linearization": {"proposal": "local_linearization"},
    "auxiliary": {"proposal": "auxiliary"},
    "gaussian_kernel": {"regularization": "gaussian_kernel"},
    "kld": {"adaptation": {"kind": "kld", "n_min": 20, "n_max": 300}},
    "augmented": {"adaptation": "augmented"},
    "sensor_resetting": {"adaptation": [{"kind": "sensor_resetting", "log_likelihood": 2.0}, "kld"]},
    "sir": {"filter": {"kind": "sir", "threads": 2}},
    "extended_kalman": {"filter": "extended_kalman"},
    "unscented_kalman": {"filter": "unscented_kalman"},
    "uniform": {"start": {"kind": "uniform", "clearance": 0.2}},
    "from_readings": {"start": "from_readings"},
    "search": {"start": "search", "measurement": "likelihood_field"},
    "jump": {"adaptation": "jump", "measurement": "likelihood_field"},
    "relocation": {"adaptation": "relocation", "measurement": "likelihood_field"},
    "scan_matching": {"refinement": "scan_matching", "measurement": "likelihood_field"},
    "strides": {"odometry_step": {"travel": 0.1}, "min_travel": 0.2, "min_turn": 0.2},
}


def scenario(**estimator: Any) -> Scenario:
    raw = {
        "title": "All there is",
        "tick_s": 0.1,
        "max_ticks": TICKS,
        "state_digest_ticks": 2,
        "map": {
            "kind": "segments",
            "segments": [[-3, -2, 3, -2], [3, -2, 3, 2], [3, 2, -3, 2], [-3, 2, -3, -2], [1, -0.4, 1, 0.4]],
        },
        "landmarks": [{"id": 1, "x": 2.9, "y": 0.5}, {"id": 2, "x": 0.5, "y": 1.9}, {"id": 3, "x": 1.0, "y": -1.9}],
        "simulator": {"kind": "room", "start": [-1.0, 0.0, 0.0]},
        "sensors": {
            "kind": "simulated",
            "odometry": {"v_std": 0.01, "w_std": 0.01},
            "landmarks": {"every": 2},
            "scan": {"beams": 5, "field_of_view": 2.0, "every": 2},
            "lines": {"every": 2},
            "position": {"every": 3},
        },
        "estimator": {"kind": "localization", "n": 200, "start": {"kind": "known", "x": -1.0}, **estimator},
        "controller": {"kind": "waypoints", "points": [[0.5, 0.8]]},
    }
    return parse_scenario(raw, "test")


def run(composed: Scenario, path: Path) -> Recording:
    record_inline(composed, path)
    return read_recording(path)


@pytest.mark.parametrize("name", COMPOSITIONS)
def test_a_composition_runs_and_replays(name: str, tmp_path: Path) -> None:
    composed = scenario(**COMPOSITIONS[name])
    recording = run(composed, tmp_path / "run.mcap")
    (boot,) = recording.boots("estimator")
    estimates = [decode(one.topic, one.payload) for one in recording.messages("estimator/state")]
    assert len(estimates) == TICKS
    last = estimates[-1]
    assert isinstance(last, Estimate)
    assert abs(last.x) < 3.5
    used = build_nodes(composed)["estimator"]
    plan = plan_of(composed)
    specs = [
        spec._replace(build=lambda: used) if name == "estimator" else spec for name, spec in plan.graph.specs.items()
    ]
    outcome = replay_node(recording, plan._replace(graph=Graph(specs)), "estimator")
    assert outcome.mismatch is None
    assert outcome.digests == TICKS // 2
    outcomes = used.freeze()["outcomes"]
    assert outcomes["used"] > 0, outcomes
    assert boot


def test_every_kind_that_a_scenario_can_name_is_among_these() -> None:
    named = {name for fields in COMPOSITIONS.values() for table in fields.values() for name in _kinds(table)}
    for field in msgspec.structs.fields(LocalizationConfig):
        for kind in _tags(msgspec.inspect.type_info(field.type)):
            assert kind in named | {"known", UserComponent.__struct_config__.tag}, f"{field.name}: {kind} is not tried"


def _kinds(table: Any) -> list[str]:
    if isinstance(table, list):
        return [name for one in table for name in _kinds(one)]
    return [table] if isinstance(table, str) else [table.get("kind", "")] if isinstance(table, dict) else []


def _tags(info: Any) -> list[str]:
    if isinstance(info, msgspec.inspect.UnionType):
        return [tag for one in info.types for tag in _tags(one)]
    if isinstance(info, msgspec.inspect.VarTupleType):
        return _tags(info.item_type)
    return [info.tag] if isinstance(info, msgspec.inspect.StructType) and isinstance(info.tag, str) else []


@pytest.mark.parametrize(
    ("estimator", "told"),
    [
        (
            {"filter": "extended_kalman", "measurement": "likelihood_field"},
            "estimator.measurement.0: the filter 'extended_kalman' needs a GaussianMeasurement; 'likelihood_field' has",
        ),
        ({"filter": "unscented_kalman", "adaptation": "kld"}, "estimator.adaptation has no place in the filter 'unsc"),
        ({"proposal": "optimal", "measurement": "polar_lines"}, "the proposal 'optimal' needs a GaussianMeasurement"),
        ({"measurement": ["range_bearing", "unknown_landmarks"]}, "already uses the messages of sensors/landmarks"),
        ({"adaptation": ["kld", "kld"]}, "expected at most one rule for the number of particles and one recovery"),
        ({"motion": "velocity", "calibration": {}}, "estimator.calibration goes with the motion of kind 'arcs' alone"),
        ({"motion": {"kind": "linear_gaussian", "transition": [[1.0]], "noise": [[1.0]]}}, "motion of x, y and theta"),
    ],
)
def test_what_does_not_fit_together_is_told(estimator: dict[str, Any], told: str) -> None:
    with pytest.raises(ScenarioError, match=told):
        build_nodes(scenario(**estimator))


@pytest.mark.parametrize(
    ("without", "estimator", "told"),
    [
        ("map", {"measurement": "likelihood_field"}, r"estimator.measurement.0 needs a \[map\]; this run has none"),
        ("map", {"measurement": "polar_lines"}, r"needs a \[map\] of segments; this run has none"),
        ("map", {"start": "uniform"}, "estimator.start: a uniform start needs a box"),
        ("map", {"start": "from_readings"}, "estimator.start: a uniform start needs a box"),
        ("map", {"adaptation": "augmented"}, "estimator.restart: a uniform start needs a box"),
        ("landmarks", {}, r"estimator.measurement.0 needs \[\[landmarks\]\]; this run has none"),
        ("sensors", {"measurement": "likelihood_field"}, "reads sensors/scan, which no node of this run writes"),
        ("sensors", {"measurement": "position"}, "reads sensors/position, which no node of this run writes"),
    ],
)
def test_what_the_run_lacks_is_told(without: str, estimator: dict[str, Any], told: str) -> None:
    whole = json.loads(resolved_json(scenario(**estimator)))
    empty: dict[str, Any] = {"map": None, "landmarks": [], "sensors": {"kind": "simulated", "odometry": {}}}
    lacking = parse_scenario({**whole, without: empty[without]}, "test")
    if without != "sensors":
        nothing = {"kind": "simulated", "odometry": {}, "scan": {"walls": [[0, 0, 1, 1]]}}
        lacking = parse_scenario({**whole, without: empty[without], "sensors": nothing}, "test")
    with pytest.raises(ScenarioError, match=told):
        build_nodes(lacking)
