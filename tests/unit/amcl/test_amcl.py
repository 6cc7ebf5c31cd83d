"""Parameters of AMCL become a scenario that loads, each told."""

import json
import math
from pathlib import Path

import pytest
from dynpf_lab.cli.main import main
from dynpf_services.scenario.load import load_scenario
from dynpf_systems.rooms.amcl.parameters import NAMES, PARAMETERS
from dynpf_systems.rooms.amcl.reading import read_parameters
from dynpf_systems.rooms.amcl.scenario import rows_of, scenario_of, toml_of

from dynpf.measurement.likelihood_field import LikelihoodFieldParams

NAV2 = "robot1:\n  amcl:\n    ros__parameters:\n"


def nav2(**values: object) -> str:
    return NAV2 + "      use_sim_time: true\n" + "".join(f"      {key}: {value}\n" for key, value in values.items())


def estimator(text: str, tmp_path: Path):
    path = tmp_path / "mine.toml"
    path.write_text(toml_of(scenario_of(read_parameters(text, "p.yaml"), 'a "name"')))
    return load_scenario(str(path)).nodes["estimator"]


def test_each_parameter_at_nav2s_and_at_ros_1s_default_has_a_row_and_loads(tmp_path: Path) -> None:
    for ros1 in (False, True):
        values = {row.name: row.ros1 if ros1 else row.default for row in PARAMETERS}
        known = {name: json.dumps(value) for name, value in values.items() if value is not None}
        text = nav2(**known)
        rows = rows_of(read_parameters(text, "p.yaml"))
        assert [row.parameter for row in rows] == ["use_sim_time", *(name for name in known if name != "use_sim_time")]
        assert all(row.becomes for row in rows)
        assert estimator(text, tmp_path).n == values["max_particles"]


def test_the_likelihood_of_a_beam_is_amcls(tmp_path: Path) -> None:
    """nav2_amcl, likelihood_field_model.cpp: z_hit exp(-d^2 / 2 sigma^2) + z_rand / range_max, cubed and added."""
    field = estimator(nav2(z_hit=0.6, z_rand=0.3, sigma_hit=0.25), tmp_path).measurement[0]
    assert isinstance(field, LikelihoodFieldParams)
    peak = field.z_hit / (math.sqrt(2.0 * math.pi) * field.sigma_hit)
    assert peak == pytest.approx(0.6)
    assert (field.z_rand, field.aggregation) == (0.3, "cubes")


def test_the_shares_of_the_beam_model_sum_to_one_and_keep_their_ratios(tmp_path: Path) -> None:
    beam = estimator(
        nav2(laser_model_type="beam", z_hit=0.5, z_short=0.05, z_max=0.05, z_rand=0.5), tmp_path
    ).measurement
    shares = beam[0].z_hit, beam[0].z_short, beam[0].z_max, beam[0].z_rand
    assert math.fsum(shares) == pytest.approx(1.0)
    assert shares[1] / shares[3] == pytest.approx(0.1)
    assert shares[0] / shares[3] == pytest.approx(math.sqrt(2.0 * math.pi) * 0.2)


def test_pf_z_is_a_quantile_and_recovery_needs_both_rates(tmp_path: Path) -> None:
    kld, *others = estimator(nav2(pf_z=1.96, recovery_alpha_fast=0.1), tmp_path).adaptation
    assert kld.probability == pytest.approx(0.975, abs=1e-4)
    assert not others
    rates = estimator(nav2(recovery_alpha_fast=0.1, recovery_alpha_slow=0.001), tmp_path).adaptation[1]
    assert (rates.alpha_slow, rates.alpha_fast) == (0.001, 0.1)


def test_the_start_is_initial_pose_where_amcl_would_take_it(tmp_path: Path) -> None:
    pose = "{x: 1.5, y: -2, z: 0, yaw: 0.3}"
    taken = estimator(nav2(set_initial_pose="true", initial_pose=pose), tmp_path).start
    assert (taken.x, taken.y, taken.theta, taken.sigma_position) == (1.5, -2.0, 0.3, 0.5)
    left = scenario_of(read_parameters(nav2(initial_pose=pose), "p.yaml"), "")["estimator"]["start"]
    assert "x" not in left
    ros1 = scenario_of(read_parameters("initial_pose_x: 3\nodom_alpha1: 0.1\n", "p.yaml"), "")["estimator"]["start"]
    assert (ros1["x"], ros1["y"]) == (3.0, 0.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (nav2(alpha1=-0.1), "p.yaml: alpha1 = -0.1; expected a finite number, 0 or more"),
        (nav2(z_hit=".nan"), "p.yaml: z_hit = nan; expected a number from 0 to 1"),
        (nav2(max_beams="[1, 2]"), "p.yaml: max_beams = [1, 2]; expected a whole number from 2 to 100000"),
        (nav2(laser_model_type="sonar"), "p.yaml: laser_model_type = 'sonar'; expected one of beam, likelihood_field"),
        (nav2(min_particles=9, max_particles=5), "min_particles = 9; expected no more than max_particles, which is 5"),
        (
            nav2(recovery_alpha_slow=0.5, recovery_alpha_fast=0.1),
            "expected less than recovery_alpha_fast, which is 0.1",
        ),
        ("a: {amcl: {z_hit: 1}}\nb: {amcl: {z_hit: 1}}", "parameters of 2 nodes (/a/amcl, /b/amcl)"),
        ("planner: {tolerance: 1}", "no parameter of AMCL in it; expected a section amcl: , the file has 'planner'"),
        ("amcl: {ros__parameters: 3}", "ros__parameters = 3; expected the parameters of amcl"),
        ("- 1", "holds [1]; expected the keys of a file of AMCL's parameters, such as amcl: ros__parameters:"),
        ("a: !!python/object/apply:os.system [ls]", "p.yaml, line 1: not YAML"),
        ("x" * 2**19, "characters; a file of AMCL's parameters has at most 262144"),
    ],
)
def test_what_is_wrong_is_told_with_file_key_value_and_expectation(text: str, told: str) -> None:
    with pytest.raises(ValueError) as error:
        read_parameters(text, "p.yaml")
    assert told in str(error.value)


def test_references_within_a_file_are_followed_once() -> None:
    layers = "".join(f"a{i}: &a{i} {{{', '.join(f'k{j}: *a{i - 1}' for j in range(30))}}}\n" for i in range(1, 5))
    text = "a0: &a0 {amcl: {z_hit: 0.9}}\n" + layers
    assert read_parameters(text, "p.yaml").values["z_hit"] == 0.9


def test_the_command_writes_a_scenario_and_tells_unknown_keys(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, output = tmp_path / "p.yaml", tmp_path / "mine.toml"
    source.write_text(nav2(z_hitt=0.5, alpha1=0.3))
    assert main(["import", "amcl", str(source), "-o", str(output)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "z_hitt 0.5 left out: AMCL has no such parameter; did you mean z_hit?" in told
    assert "alpha1 0.3 estimator.motion.alpha_1" in told
    assert load_scenario(str(output)).nodes["estimator"].motion.alpha_1 == 0.3
    assert main(["import", "amcl", str(source), "-o", str(output)]) == 2
    assert "the file exists" in capsys.readouterr().err


def test_every_name_is_one_parameter() -> None:
    assert len(NAMES) == len(PARAMETERS)
