import platform
import sys
import warnings

import numpy as np
import pytest
from dynpf_lab.cli import list_
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import RunError, StepError, UsageError

import dynpf

COMMANDS = ["list", "run", "service", "health", "replay", "play", "diff", "info", "doctor", "recover"]
COMMANDS += ["metrics", "import", "export", "study", "bench"]


def fail(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Let ``dynpf list`` end with ``error``."""

    def run(_options: object) -> int:
        raise error

    monkeypatch.setattr(list_, "run", run)


@pytest.mark.parametrize("words", [["--help"], ["-h"]])
def test_help_shows_all_commands(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert all(f"\n  {command} " in told.out for command in COMMANDS)


def test_the_version_is_told_with_those_of_what_dynpf_stands_on(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith(f"dynpf {dynpf.__version__} (CPython {platform.python_version()}, ")
    assert f", numpy {np.__version__}, " in second
    assert "matplotlib" not in second  # an extra


@pytest.mark.parametrize(
    ("module", "warns"), [("dynpf_systems.rooms", False), ("numpy._core.x", False), ("mine", True)]
)
def test_numpy_warns_only_in_the_user_s_own_modules(module: str, warns: bool) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.resetwarnings()
        main(["--version"])
        warnings.warn_explicit("overflow", RuntimeWarning, "file.py", 1, module)
    assert bool(caught) == warns


def test_no_command_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert capsys.readouterr().out.startswith("usage: dynpf COMMAND")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_tells_of_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    told = capsys.readouterr()
    assert told.out.startswith(f"usage: dynpf {command}")
    assert told.err == ""


@pytest.mark.parametrize(
    ("word", "hint"), [("rnu", "did you mean 'run'?"), ("xyzzy", "dynpf --help shows the commands")]
)
def test_an_unknown_command_is_told_with_the_nearest(word: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([word]) == 2
    assert capsys.readouterr() == ("", f"dynpf: unknown command {word!r}; {hint}\n")


@pytest.mark.parametrize("words", [["list", "--no-such-option"], ["run"], ["service", "estimator"]])
def test_wrong_options_are_wrong_usage(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert f"dynpf {words[0]}: error: " in told.err


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (UsageError("not so"), 2, "dynpf list: not so\n"),
        (RunError("it broke"), 1, "dynpf list: it broke\n"),
        (KeyboardInterrupt(), 1, "dynpf list: stopped\n"),
    ],
)
def test_errors_are_told_in_one_line_and_by_the_exit_code(
    error: BaseException, code: int, told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fail(monkeypatch, error)
    assert main(["list"]) == code
    assert capsys.readouterr() == ("", told)


def test_a_bug_in_a_node_of_ones_own_is_told_with_its_traceback(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    error = StepError("estimator failed in step 3")
    try:
        raise ZeroDivisionError("by nothing")
    except ZeroDivisionError as cause:
        error.__cause__ = cause
    fail(monkeypatch, error)
    assert main(["list"]) == 1
    told = capsys.readouterr().err
    assert "ZeroDivisionError: by nothing" in told
    assert told.endswith("dynpf list: estimator failed in step 3\n")


def test_a_step_of_a_shipped_node_fails_in_a_sentence(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    error = StepError("estimator failed in step 3")
    error.__cause__ = ValueError("shapes (2, 2) and (3, 2)")
    fail(monkeypatch, error)
    assert main(["list"]) == 1
    assert capsys.readouterr().err == "dynpf list: estimator failed in step 3\n"


@pytest.mark.parametrize(
    ("error", "told"),
    [(MemoryError(), "not enough memory"), (OSError(28, "No space left on device"), "No space left on device")],
)
def test_what_the_machine_lacks_is_told_in_a_sentence(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    fail(monkeypatch, error)
    assert main(["list"]) == 1
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


def test_done_is_0_and_the_words_are_those_of_the_command_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["dynpf", "list"])
    assert main() == 0
    assert "landmark-room" in capsys.readouterr().out
