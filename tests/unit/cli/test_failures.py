"""Errors that no command has foreseen reach a person as one sentence."""

import errno
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest
import zenoh
from dynpf_lab.cli import main as command_line
from dynpf_lab.cli import schema
from dynpf_protocol.errors import BadMessageError

ERRORS = [
    (OSError(errno.ENAMETOOLONG, "File name too long", "a.mcap"), "a.mcap: file name too long"),
    (OSError(errno.ENOSPC, "No space left on device"), "the system refused something: No space left on device"),
    (RecursionError("maximum recursion depth exceeded"), "nested too deeply"),
    (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"), "a text cannot be read or written here"),
    (BadMessageError("truth/robot: Expected `float`"), "a message breaks the protocol: truth/robot"),
    (zenoh.ZError("Transport closed at /somewhere/in/rust.rs:12."), "the bus failed: Transport closed"),
    (KeyError("no/such"), "a fault of dynpf itself, not of yours: KeyError: 'no/such'"),
]


@pytest.mark.parametrize(("error", "sentence"), ERRORS, ids=[type(error).__name__ for error, _ in ERRORS])
def test_an_unforeseen_error_is_told_in_a_sentence(
    error: Exception, sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_options: Namespace) -> int:
        raise error

    monkeypatch.setattr(schema, "run", fail)
    assert command_line.main(["schema"]) == 1
    told = capsys.readouterr().err
    assert told.startswith("dynpf schema: ")
    assert sentence in told
    assert told.count("\n") == 1
    monkeypatch.setenv("DYNPF_TRACEBACK", "1")  # the control: for those who look for the fault
    command_line.main(["schema"])
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["estimator", "--listen", "tcp/127.0.0.1:1"], "--listen tcp/127.0.0.1:1: estimator has no use for it"),
        (["router", "--connect", "tcp/127.0.0.1:1"], "--connect tcp/127.0.0.1:1: router has no use for it"),
        (["router", "-o", "run.mcap"], "--output run.mcap: router has no use for it; it is for the recorder alone"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command_line.main(["service", words[0], "landmark-room", *words[1:]]) == 2
    assert sentence in capsys.readouterr().err


def test_an_output_with_too_long_a_name_or_a_byte_0_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("n" * 300, "a\0b"):
        assert command_line.main(["run", "landmark-room", "-o", str(tmp_path / name)]) == 2
        assert "cannot be written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_not_utf_8_is_printed_in_any_locale(tmp_path: Path) -> None:
    name = str(tmp_path / "r\udcff.mcap")
    command = [sys.executable, "-P", "-m", "dynpf_lab.cli.main", "info", name]
    told = subprocess.run(command, env={"LC_ALL": "POSIX"}, capture_output=True, check=False)
    assert told.returncode == 2
    assert b"no such file" in told.stderr
    assert b"Traceback" not in told.stderr
