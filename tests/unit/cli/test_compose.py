"""``dynpf compose``: the file that comes along is made by it, and it follows any scenario."""

import re
import shlex
from pathlib import Path

import pytest
import yaml
from dynpf_lab.cli.main import main
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

ROOT = Path(__file__).parents[3]


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["compose", *words]) == 0
    return capsys.readouterr().out


def test_the_file_that_comes_along_is_current(capsys: pytest.CaptureFixture[str]) -> None:
    assert (ROOT / "compose.yaml").read_text() == printed(capsys, "parts-3-easy", "--keys", "keys")


@pytest.mark.parametrize("scenario", ["landmark-filters", "parts-3-tracked", "room-scan"])
def test_each_process_of_a_scenario_has_its_container_and_no_other_has(
    scenario: str, capsys: pytest.CaptureFixture[str]
) -> None:
    services = yaml.safe_load(printed(capsys, scenario, "--set", "max_ticks=7"))["services"]
    nodes = plan_of(load_scenario(scenario)).graph.nodes
    assert [*services] == ["router", *nodes, "recorder"]
    for name, service in services.items():
        where = ["--listen", "tcp/0.0.0.0:7447"] if name == "router" else ["--connect", "tcp/router:7447"]
        words = ["service", name, scenario, "--set", "max_ticks=7", "--seed", "${SEED:-1}", *where, "--insecure"]
        kept = ["-o", f"runs/{scenario}-${{SEED:-1}}-{{host}}.mcap"] if name == "recorder" else []
        assert service["command"] == [*words, *kept]
        assert service["restart"] == "on-failure:3"
        assert service["healthcheck"]["test"][:4] == ["CMD", "dynpf", "health", name]


def test_no_container_can_change_its_image_or_gain_privileges(capsys: pytest.CaptureFixture[str]) -> None:
    services = yaml.safe_load(printed(capsys, "parts-3-easy"))["services"]
    for name, service in services.items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert [volume for volume in service["volumes"] if volume.startswith("recordings")] == (
            ["recordings:/dynpf/runs"] if name == "recorder" else []
        )


def test_files_of_ones_own_are_mounted_where_the_command_looks_for_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "own.toml").write_text((ROOT / "scenarios/dynpf_scenarios/landmark-room.toml").read_text())
    (tmp_path / "code").mkdir()
    made = yaml.safe_load(printed(capsys, "mine/own.toml", "--code", "code", "--set", "title='a $5 robot'"))
    service = made["services"]["estimator"]
    assert service["volumes"] == ["/var/cache/dynpf", f"{tmp_path}/mine:/scenario:ro", f"{tmp_path}/code:/code/0:ro"]
    assert shlex.join(service["command"]).startswith("service estimator /scenario/own.toml --set")
    assert "title='a $$5 robot'" in service["command"]
    assert made["services"]["recorder"]["volumes"][-1] == "recordings:/dynpf/runs"


def test_the_nodes_of_several_robots_have_names_that_compose_takes(capsys: pytest.CaptureFixture[str]) -> None:
    services = yaml.safe_load(printed(capsys, "landmark-team", "--set", "needs_log=true"))["services"]
    assert services["r3.estimator"]["command"][:2] == ["service", "r3/estimator"]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+", name) for name in services)


def test_with_keys_each_process_gets_its_own_as_secrets_and_no_other(capsys: pytest.CaptureFixture[str]) -> None:
    made = yaml.safe_load(printed(capsys, "parts-3-tracked", "--keys", "some/$keys"))
    for name, service in made["services"].items():
        revoked = ["revoked"] if name == "router" else []
        assert service["secrets"] == ["ca.pem", f"{name}.pem", f"{name}.key", *revoked]
        assert "--insecure" not in service["command"]
        for words in (service["command"], service["healthcheck"]["test"]):
            assert "--keys=/run/secrets" in words
            assert not any(word.startswith("tcp/") for word in words)
    files = [file for name in made["services"] for file in (f"{name}.pem", f"{name}.key")]
    assert made["secrets"].keys() == {"ca.pem", "revoked", *files}
    assert made["secrets"]["router.key"]["file"] == "./some/$$keys/router.key"


def test_no_value_of_a_setting_becomes_a_part_of_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    odd = 'title="""recordings: null\nx-evil: [1] #"""'
    made = yaml.safe_load(printed(capsys, "landmark-room", "--set", odd))
    assert [*made] == ["services", "volumes"]
    assert odd in made["services"]["estimator"]["command"]


def test_a_folder_with_a_colon_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "b:c"
    folder.mkdir()
    (folder / "own.toml").write_text((ROOT / "scenarios/dynpf_scenarios/landmark-room.toml").read_text())
    assert main(["compose", str(folder / "own.toml")]) == 2
    assert "Compose takes no folder with ':'" in capsys.readouterr().err
