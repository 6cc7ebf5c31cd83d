"""``dynpf keys``, and how a command says that it needs them."""

import re
from pathlib import Path

import pytest
from dynpf_lab.cli.main import main

Printed = pytest.CaptureFixture[str]


def refused(capsys: Printed, *words: str) -> str:
    assert main(words) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1, told
    return told


def test_keys_are_made_listed_and_revoked_in_words(
    tmp_path: Path, capsys: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["keys", "init", "keys"]) == 0
    assert main(["keys", "issue", "--scenario", "parts-3-easy", "--host", "robot", "--days", "3"]) == 0
    assert main(["keys", "revoke", "vision"]) == 0
    assert "no access from its next start on" in capsys.readouterr().out
    assert main(["keys", "issue", "vision"]) == 0
    assert re.fullmatch(r"vision@1: until \d{4}-\d\d-\d\d \d\d:\d\d UTC\n", capsys.readouterr().out)
    assert main(["keys", "issue", "sensors", "--days", "2"]) == 0
    assert re.match(r"sensors: .*; replaces the one until .* UTC, which stays valid\n", capsys.readouterr().out)
    assert main(["keys", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [
        "controller",
        "estimator",
        "observer",
        "operator",
        "recorder",
        "router",
        "sensors",
        "simulator",
        "vision@1",
    ]
    assert [line.split()[0] for line in lines] == ["dynpf", *names, "vision"]
    assert all(re.search(r"UTC, [23]\.\d days$", line) for line in lines[1:9])
    assert lines[-1].split() == ["vision", "revoked"]


def test_keys_says_what_is_missing(tmp_path: Path, capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "dynpf keys init" in refused(capsys, "keys", "issue", "vision")
    assert "dynpf keys init" in refused(capsys, "keys", "list")
    assert "give the NAME" in refused(capsys, "keys", "issue")
    assert "not among the names" in refused(capsys, "keys", "issue", "vision", "--host", "robot")


@pytest.mark.parametrize("where", ["tcp/0.0.0.0:7447", "tcp/robot:7447", "tcp/10.0.0.7:7447", "tcp/[::]:7447"])
def test_plain_tcp_beyond_this_machine_is_refused_and_says_what_to_do(where: str, capsys: Printed) -> None:
    option = "--listen" if "0.0.0.0" in where or "::" in where else "--connect"
    name = "router" if option == "--listen" else "estimator"
    told = refused(capsys, "service", name, "landmark-room", option, where)
    assert where in told
    assert "give --keys FOLDER" in told
    assert "--insecure" in told
    for command in (["play", "nowhere.mcap"], ["health", "estimator"]):
        assert where in refused(capsys, *command, "--connect", where)


def test_an_address_that_does_not_fit_the_keys_is_refused(tmp_path: Path, capsys: Printed) -> None:
    assert "takes keys" in refused(capsys, "health", "estimator", "--connect", "tls/127.0.0.1:1")
    keys = ["--keys", str(tmp_path)]
    assert "it is tls/127.0.0.1:1" in refused(capsys, "health", "estimator", "--connect", "tcp/127.0.0.1:1", *keys)
    assert "no such certificate" in refused(capsys, "health", "estimator", *keys)


@pytest.mark.parametrize("where", ["tcp/127.0.0.1:1", "tcp/localhost:1", "tcp/[::1]:1", "tcp/127.1.2.3:1"])
def test_plain_tcp_on_this_machine_goes_without_a_word(where: str, capsys: Printed) -> None:
    """The control: it gets as far as looking for the router."""
    assert main(["health", "estimator", "--connect", where, "--timeout", "0"]) == 1
    assert "no router" in capsys.readouterr().err
