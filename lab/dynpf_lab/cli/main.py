"""``dynpf``: dispatches each command to its module, and loads only that module."""

import argparse
import difflib
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from typing import Any, NoReturn

from dynpf_protocol.errors import DynpfError, StepError

from dynpf_lab.cli.failures import sentence
from dynpf_lab.cli.loading import loading

__all__ = ["main"]

_COMMANDS = {
    "list": ("list_", "scenarios, one line each"),
    "run": ("run", "run a scenario, all processes, into one recording"),
    "bridge": ("bridge", "localize a live ROS 2 robot by a scenario, into one recording"),
    "record": ("record", "what is said on keys of Zenoh and topics of ROS 2, and what is lost"),
    "service": ("service", "one process of a run on its own"),
    "schema": ("schema", "the JSON schema of scenario files, for editors"),
    "compose": ("compose", "a Compose file of a scenario, one container a process"),
    "health": ("health", "whether a process of a run is alive and its main loop runs"),
    "stop": ("stop", "ask a run to end with its next tick, as its operator"),
    "keys": ("keys", "keys and certificates for the processes of a run"),
    "view": ("view", "the page of a run, or of two side by side, in a browser"),
    "plot": ("plot", "a figure of a run, or a film of it"),
    "replay": ("replay", "re-execute nodes from a recording and compare"),
    "play": ("play", "publish a recording onto the bus"),
    "diff": ("diff", "first difference of two recordings"),
    "bisect": ("bisect", "which setting, module or commit made two runs differ"),
    "info": ("info", "what is in a recording"),
    "doctor": ("doctor", "what is wrong with a recording"),
    "sign": ("sign", "sign every byte of a recording"),
    "resume": ("resume", "go on with a run that was stopped, or of which everything was killed"),
    "recover": ("recover", "repair a recording into a new file"),
    "localize": ("localize", "from a robot's log to a verdict: import, run, measures and page"),
    "metrics": ("metrics", "measures of a recorded run against its truth"),
    "explain": ("explain", "why a run went as it did: each verdict of its filters, and what happened then"),
    "fit": ("fit", "the beam model's parameters from a recorded run"),
    "import": ("import_", "make a recording from a log of another format"),
    "export": ("export", "write a topic of a recording for other programs"),
    "study": ("study", "an experiment of the source documents, with confidence intervals"),
    "why": ("why", "when a run could not but fail any more, and the cause"),
    "sim": ("sim", "simulate the processes of a run under faults"),
    "sweep": ("sweep", "a scenario with several settings, over many seeds"),
    "bench": ("bench", "times of updates, against plain NumPy and other libraries"),
    "references": ("references", "check the reference recordings, or record them again"),
}

_EXPECTED = {"int": "expected a whole number", "float": "expected a number"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done or same, 1 differs or failed, 2 wrong usage."""
    for variable in ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(variable, "1")  # for small matrices and images threads cost more than they gain
    _tell_no_warnings()
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    _print_any_name()
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        from dynpf_lab.cli.version import versions

        print(versions())
        return 0
    if not words or words[0] in {"-h", "--help"}:
        print(_overview())
        return 0 if words else 2
    command = words[0]
    if command not in _COMMANDS:
        close = difflib.get_close_matches(command, [*_COMMANDS, "--version"], n=1)
        hint = f"did you mean {close[0]!r}?" if close else "dynpf --help shows the commands"
        print(f"dynpf: unknown command {command!r}; {hint}", file=sys.stderr)
        return 2
    return _execute(command, words)


def _tell_no_warnings() -> None:
    """Keep back what OpenCV and NumPy warn of: dynpf tells itself what is wrong with an image or a number.

    Who sets OPENCV_LOG_LEVEL or PYTHONWARNINGS sees them, and a user's own modules warn as they do elsewhere.
    """
    os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")
    warnings.filterwarnings("ignore", category=RuntimeWarning, module=r"(dynpf|numpy)\b|dynpf_", append=True)


def _print_any_name() -> None:
    """Let names of files be printed that the terminal's encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _execute(command: str, words: Sequence[str]) -> int:
    """Run a command, tell its errors, and return its exit code."""
    label = command
    try:
        with loading():
            parser, commands = _parser()
            _load(command, commands)
        options, unknown = parser.parse_known_args(words)
        if unknown:
            commands.choices[command].error(f"unrecognized arguments: {' '.join(unknown)}")
        label = options.name if command == "service" else command
        return int(options.run(options))
    except DynpfError as error:
        if isinstance(error, StepError) and error.__cause__ is not None and _in_users_code(error.__cause__):
            traceback.print_exception(error.__cause__)
        print(f"dynpf {label}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"dynpf {label}: stopped", file=sys.stderr)
    except MemoryError:
        print(f"dynpf {label}: not enough memory", file=sys.stderr)
    except BrokenPipeError:
        sys.stderr.close()
    except SystemExit as stop:  # argparse has printed the error
        return stop.code if isinstance(stop.code, int) else 2
    except Exception as error:
        if os.environ.get("DYNPF_TRACEBACK"):
            traceback.print_exception(error)
        print(f"dynpf {label}: {sentence(error)}", file=sys.stderr)
    return 1


def _in_users_code(error: BaseException) -> bool:
    """Return whether an exception passed through code of the user's own, who then wants to see where."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        shipped = package.startswith("dynpf") or package in sys.stdlib_module_names
        if not shipped and "site-packages" not in frame.f_code.co_filename:
            return True
    return False


class _Parser(argparse.ArgumentParser):
    """A parser that tells of a mistake in one line."""

    def error(self, message: str) -> NoReturn:
        """Tell what is wrong and where the options are told, and exit with code 2."""
        text = re.sub(r"invalid (int|float) value: (.*)", lambda found: f"{found[2]}: {_EXPECTED[found[1]]}", message)
        if message.startswith("unrecognized arguments: "):
            word = message.split()[2].partition("=")[0]
            close = difflib.get_close_matches(word, self._option_string_actions, n=1)
            text += f"; did you mean {close[0]}?" if close else ""
        self.exit(2, f"{self.prog}: error: {text} ({self.prog} --help tells the options)\n")


def _parser() -> "tuple[argparse.ArgumentParser, argparse._SubParsersAction[Any]]":
    parser = _Parser(prog="dynpf", allow_abbrev=False)
    return parser, parser.add_subparsers(required=True)


def _load(command: str, commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the parser of a command, with the arguments from the command's module."""
    module, text = _COMMANDS[command]
    import_module(f"dynpf_lab.cli.{module}").add_arguments(
        commands.add_parser(command, help=text, description=f"{text[:1].upper()}{text[1:]}.")
    )


def _complete() -> None:
    """Print the completions of the shell's line, and exit."""
    from dynpf_lab.cli.completion import complete

    parser, commands = _parser()
    typed = os.environ["COMP_LINE"].split()
    for command, (_, text) in _COMMANDS.items():
        if command in typed[1:2]:
            _load(command, commands)
        else:
            commands.add_parser(command, help=text)
    complete(parser)


def _overview() -> str:
    rows = "\n".join(f"  {name:<11} {text}" for name, (_, text) in _COMMANDS.items())
    return (
        "usage: dynpf COMMAND ...\n\nA localization laboratory: processes on a bus, one recording a run, exact replay."
        f"\n\n{rows}\n\ndynpf COMMAND --help tells more, dynpf --version the versions in use. Exit codes: 0 done or "
        "the same, 1 differs\nor failed, 2 wrong usage."
    )


if __name__ == "__main__":
    sys.exit(main())
