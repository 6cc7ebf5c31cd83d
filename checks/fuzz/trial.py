"""One trial: an action on a hostile input, its outcome, and what it took of time and memory."""

import signal
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from dynpf_protocol.errors import DynpfError, ProtocolError, StepError

__all__ = ["LIMITS", "Limits", "Outcome", "Verdict", "WrongAnswerError", "tried", "tried_together"]

_SHOWN = 300  # characters of a text


class Verdict(StrEnum):
    """What came of an input."""

    ACCEPTED = "accepted"
    REFUSED = "refused"  # with a sentence for a person
    FAILED = "failed"  # a node raised in a step, of a value that it was made with or read
    FAULT = "fault"


class Limits(NamedTuple):
    """What one trial may take."""

    seconds: float = 2.0  # of processor time
    bytes: int = 300 * 2**20  # above what the process had before
    hang_seconds: float = 20.0  # of wall-clock time, after which a trial is broken off


LIMITS = Limits()


class Outcome(NamedTuple):
    """What came of a trial; ``text`` is the refusal, or the fault with the place in the sources."""

    verdict: Verdict
    text: str
    seconds: float
    bytes: int


class WrongAnswerError(Exception):
    """A command answered, but wrongly: "same" for a changed file, or a recovered file that cannot be read."""


class _HangError(BaseException):
    """A trial took too long; no ``except Exception`` catches it."""


def tried(action: Callable[[], object], limits: Limits = LIMITS) -> Outcome:
    """Run an action; anything but an answer or a refusal, and anything above the limits, is a fault."""
    before = _resident()
    _restart_peak()
    verdict, text, seconds, _ = _timed(action, limits)
    taken = max(_peak() - before, 0)
    if verdict is not Verdict.FAULT and taken > limits.bytes:
        verdict, text = Verdict.FAULT, f"took {taken / 2**20:.0f} MB; {text}"
    return Outcome(verdict, text, seconds, taken)


def tried_together(makers: Sequence[Callable[[], Callable[[], object]]], limits: Limits = LIMITS) -> list[Outcome]:
    """Make and run many short actions; if they take too much memory together, each is run again by itself."""
    before = _resident()
    _restart_peak()
    outcomes = [_timed(make(), limits) for make in makers]
    if _peak() - before > limits.bytes:
        return [tried(make(), limits) for make in makers]
    return outcomes


def _timed(action: Callable[[], object], limits: Limits) -> Outcome:
    began = time.process_time()
    verdict, text = Verdict.ACCEPTED, ""
    try:
        with _broken_off(limits.hang_seconds):
            action()
    except StepError as error:
        verdict, text = Verdict.FAILED, f"{error} ({_own(error.__cause__ or error)})"
    except (DynpfError, ProtocolError) as error:
        verdict, text = Verdict.REFUSED, str(error)
    except _HangError:
        verdict, text = Verdict.FAULT, f"still busy after {limits.hang_seconds} s"
    except (Exception, SystemExit) as error:  # it would reach a person as a traceback, or end a program that calls us
        verdict, text = Verdict.FAULT, _placed(error)
    seconds = time.process_time() - began
    if verdict is not Verdict.FAULT and seconds > limits.seconds:
        verdict, text = Verdict.FAULT, f"took {seconds:.1f} s; {text}"
    return Outcome(verdict, text[:_SHOWN], seconds, 0)


def _placed(error: BaseException) -> str:
    """Return an exception as a line, with the lines of the sources that led to it."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]} ({_own(error)})"


def _own(error: BaseException) -> str:
    """Return the last lines of dynpf's sources that led to an exception."""
    frames = traceback.extract_tb(error.__traceback__)[-40:]
    own = [f"{Path(frame.filename).stem}:{frame.lineno}" for frame in frames if "site-packages" not in frame.filename]
    return " > ".join(own[-5:])


@contextmanager
def _broken_off(seconds: float) -> Iterator[None]:
    def stop(_signal: int, _frame: FrameType | None) -> Any:
        raise _HangError

    previous = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def _resident() -> int:
    return _status("VmRSS")


def _peak() -> int:
    return _status("VmHWM")


def _status(name: str) -> int:
    """Return an entry of the process's memory in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    return 0


def _restart_peak() -> None:
    """Let the peak of the resident memory begin anew."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return  # the peak is then that of the whole process, and only the first trial above it is noticed
