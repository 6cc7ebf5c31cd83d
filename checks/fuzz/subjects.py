"""What is tried on hostile input: the commands that read files, and the decoders of what comes from the bus."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from io import BytesIO, TextIOWrapper
from pathlib import Path
from types import ModuleType

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli import diff, doctor, export, fit, import_, info, keys, metrics, recover, replay, sign, view

from checks.fuzz.trial import WrongAnswerError

__all__ = ["command", "difference", "quiet", "recovered"]

SAME, DIFFERENT, WRONG_USAGE = 0, 1, 2

_COMMANDS: dict[str, ModuleType] = {
    "diff": diff,
    "doctor": doctor,
    "export": export,
    "fit": fit,
    "import": import_,
    "info": info,
    "keys": keys,
    "metrics": metrics,
    "recover": recover,
    "replay": replay,
    "sign": sign,
    "view": view,
}


@cache
def _parser(name: str) -> tuple[ModuleType, argparse.ArgumentParser]:
    module = _COMMANDS[name]
    parser = argparse.ArgumentParser(prog=f"dynpf {name}", allow_abbrev=False)
    module.add_arguments(parser)
    return module, parser


def command(name: str, *words: str | Path) -> int:
    """Execute a command as the command line does, but let what it raises through; return its exit code."""
    _, parser = _parser(name)
    options = parser.parse_args([str(word) for word in words])
    with quiet():
        return int(options.run(options))


@contextmanager
def quiet() -> Iterator[None]:
    """Let standard output and error go nowhere, through an encoder such as the command line has."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (TextIOWrapper(BytesIO(), "utf-8", "backslashreplace") for _ in before)  # as main does
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = before


def recovered(path: Path, output: Path) -> None:
    """Recover a file; what comes out must be readable."""
    try:
        command("recover", path, "-o", output)
        try:
            read_recording(output)
        except RecordingError as error:
            raise WrongAnswerError(f"the recovered file cannot be read: {error}") from error
    finally:
        output.unlink(missing_ok=True)


def difference(sound: Path, path: Path) -> None:
    """Compare a file with the sound one that it was made of: "same" goes with equal digests, and only with them."""
    said = command("diff", sound, path)
    equal = _digest(sound) == _digest(path)
    if equal != (said == SAME):
        raise WrongAnswerError(f"diff returns {said}, and the content digests are {'equal' if equal else 'different'}")


def _digest(path: Path) -> str:
    return content_digest(read_recording(path, allow_truncated=True))
