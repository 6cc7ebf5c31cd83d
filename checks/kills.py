"""Runs whose processes are killed and stopped at random moments: whether they have the bytes of an undisturbed run.

``python -m checks.kills --kills 100 --stops 50 --doubles 30 --seed 0`` starts ``dynpf run`` again and again and sends
one of its processes SIGKILL or SIGSTOP, at a moment between its first process and its end, or kills two of them, the
second up to two seconds after the first. Every run has to end with the content digest of an undisturbed one; only when
``dynpf run`` itself is killed, all has to end, and ``dynpf resume`` goes on with it, to the same digest.
``--everything 50`` kills all processes of a run at once, and resumes it. ``--cold 50`` starts it with an empty
cache of kernels while other processes keep the machine busy: nobody may be named then. Durations are this machine's.
``--scenario parts-3-easy``, or ``--scenario laser-log --log INTEL.mcap``, does that to another run than landmark-room.
"""

import argparse
import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main as dynpf

SUPERVISOR = "run"
NAMED_S = 3.0
"""Within this a process has to be named, and all have to be gone when the starting process was killed."""

PATIENCE_S = 60.0
POLL_S = 0.01
BUSY = 2  # processes that keep the machine busy during cold starts


class Outcome(NamedTuple):
    """What became of one run."""

    named_s: float | None  # None if it had ended before the signal, or nobody was left to name anyone
    gone_s: float  # until its last process had gone
    whole: bool  # whether the recording is complete, and has the digest of an undisturbed run
    faults: tuple[str, ...]


class Undisturbed(NamedTuple):
    """A run that nobody disturbs: the words after ``dynpf run``, its processes, how long it lasts, its digest.

    ``log`` are the words that also ``dynpf resume`` needs for the log that the run plays, if any.
    """

    words: tuple[str, ...]
    log: tuple[str, ...]
    processes: tuple[str, ...]
    lasts_s: float  # from its last process's start to its end
    digest: str


def main() -> int:
    """Run the trials and print a table; the exit code is 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m checks.kills")
    parser.add_argument("--kills", type=int, default=10, metavar="N", help="runs of which a process is killed")
    parser.add_argument("--stops", type=int, default=5, metavar="N", help="runs of which a process is stopped")
    parser.add_argument("--doubles", type=int, default=0, metavar="N", help="runs of which two processes are killed")
    parser.add_argument("--everything", type=int, default=0, metavar="N", help="runs that are killed whole and resumed")
    parser.add_argument("--cold", type=int, default=0, metavar="N", help="starts with an empty cache, under load")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--scenario", default="landmark-room", metavar="NAME", help="which run (landmark-room)")
    parser.add_argument("--ticks", type=int, default=300, metavar="N", help="how long a run is at most (300)")
    parser.add_argument("--log", metavar="IN.mcap", help="the log of a scenario that needs one")
    options = parser.parse_args()
    random = Random(options.seed)
    log = ("--log", options.log) if options.log else ()
    words = (options.scenario, "--set", f"max_ticks={options.ticks}", *log)
    trials = options.kills + options.stops + options.doubles + options.everything
    undisturbed = _undisturbed(words, log) if trials else Undisturbed(words, log, (), 0.0, "")
    outcomes: dict[str, list[Outcome]] = defaultdict(list)
    for number, count, second in (
        (signal.SIGKILL, options.kills, False),
        (signal.SIGSTOP, options.stops, False),
        (signal.SIGKILL, options.doubles, True),
    ):
        # A stopped supervisor stops nobody but itself.
        processes = undisturbed.processes
        targets = (*processes, SUPERVISOR) if number is signal.SIGKILL and not second else processes
        for trial in range(count):
            target, after_s = targets[trial % len(targets)], random.uniform(0.0, undisturbed.lasts_s)
            then = (random.choice(processes), random.uniform(0.0, 2.0)) if second else None
            outcome = _disturbed(target, number, after_s, then, undisturbed)
            what = f"{number.name} {target}" if then is None else "SIGKILL of two"
            print(f"\r{what} {trial + 1} of {count} ", end="", file=sys.stderr, flush=True)
            outcomes[what].append(outcome)
            for fault in outcome.faults:
                print(
                    f"{what} ({target}, {then}) after {after_s:.2f} s of {undisturbed.lasts_s:.2f} s: {fault}",
                    flush=True,
                )
    if outcomes:
        _print_table(outcomes, undisturbed.lasts_s)
    faults = _everything(options.everything, random, undisturbed)
    faults += sum(len(outcome.faults) for rows in outcomes.values() for outcome in rows)
    return int(faults + _cold(words, options.cold) > 0)


def _print_table(outcomes: dict[str, list[Outcome]], lasts_s: float) -> None:
    print(f"\nan undisturbed run: {lasts_s:.2f} s")
    print(
        f"{'signal to':20} {'runs':>5} {'same bytes':>11} {'named':>6} "
        f"{'after at most':>14} {'end at most':>12} {'faults':>7}"
    )
    for what, rows in sorted(outcomes.items()):
        named = [row.named_s for row in rows if row.named_s is not None]
        longest = f"{max(named):12.2f} s" if named else f"{'-':>14}"
        gone_s, faults = max(row.gone_s for row in rows), sum(len(row.faults) for row in rows)
        whole = sum(row.whole for row in rows)
        print(f"{what:20} {len(rows):5} {whole:11} {len(named):6} {longest} {gone_s:10.2f} s {faults:7}", flush=True)


class _Run:
    """One ``dynpf run``, all of whose files lie in ``folder``, which marks its processes."""

    def __init__(self, folder: Path, *words: str, **environment: str) -> None:
        self.path = folder / "run.mcap"
        self._folder = folder
        self._errors = folder / "stderr"
        command = [sys.executable, "-P", "-m", "dynpf_lab.cli.main", "run", *words]
        command += ["-o", str(self.path)]
        variables = {**os.environ, "TMPDIR": str(folder), **environment}
        with self._errors.open("wb") as errors:
            self.popen = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=errors, env=variables, start_new_session=True
            )

    @property
    def errors(self) -> str:
        return self._errors.read_text()

    def processes(self) -> dict[int, str]:
        """Return the living processes but the first one: id to name of the service, or "guard"."""
        found = {}
        for entry in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = entry.read_bytes().decode(errors="replace").replace("\0", " ").split()
                if words[1:2] in (["service"], ["guard"]) and any(str(self._folder) in word for word in words):
                    found[int(entry.parent.name)] = words[2] if words[1] == "service" else "guard"
        return found

    def await_process(self, name: str) -> int | None:
        """Return the id of a process once it is there, or None if the run ends before."""
        while self.popen.poll() is None:
            for pid, service in self.processes().items():
                if service == name:
                    return pid
            time.sleep(POLL_S)
        return None

    def services(self) -> tuple[str, ...]:
        """Return the names of the services that are seen until the run ends, in the order in which they came."""
        seen: dict[str, None] = {}
        while self.popen.poll() is None:
            seen |= dict.fromkeys(self.processes().values())
            time.sleep(POLL_S)
        return tuple(name for name in seen if name != "guard")

    def kill(self) -> None:
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.popen.kill()
        self.popen.wait()


@contextlib.contextmanager
def _run(*words: str, **environment: str) -> Iterator[_Run]:
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        run = _Run(Path(name), *words, **environment)
        try:
            yield run
        finally:
            run.kill()


def _undisturbed(words: tuple[str, ...], log: tuple[str, ...]) -> Undisturbed:
    """Return what an undisturbed run is like; its first run finds its processes, and compiles the kernels."""
    with _run(*words) as run:
        processes = run.services()
    with _run(*words) as run:
        run.await_process(processes[-1])
        began = time.monotonic()
        run.popen.wait()
        lasts_s = time.monotonic() - began
        return Undisturbed(words, log, processes, lasts_s, content_digest(read_recording(run.path)))


def _disturbed(
    target: str, number: signal.Signals, after_s: float, then: tuple[str, float] | None, undisturbed: Undisturbed
) -> Outcome:
    """Send a signal to one process of a run, ``then`` kill another, and see what becomes of it."""
    with _run(*undisturbed.words) as run:
        pid = run.await_process(undisturbed.processes[-1] if target == SUPERVISOR else target)
        time.sleep(after_s)
        sent_s = time.monotonic()
        _send(run, run.popen.pid if target == SUPERVISOR else pid, number)
        named_s, next_ = None, then
        while (left := run.processes()) or run.popen.poll() is None:
            waited_s = time.monotonic() - sent_s
            if next_ is not None and waited_s >= next_[1] and next_[0] in left.values():
                _send(run, next(pid for pid, name in left.items() if name == next_[0]), signal.SIGKILL)
                next_ = None
            if named_s is None and any(text in run.errors for text in _names(target)):
                named_s = waited_s
            if waited_s > PATIENCE_S:
                break
            time.sleep(POLL_S)
        gone_s = time.monotonic() - sent_s
        if named_s is None and any(text in run.errors for text in _names(target)):
            named_s = gone_s
        others = () if then is not None else tuple(name for name in undisturbed.processes if name != target)
        faults = [*_faults(run, target, named_s, gone_s, others), *_file_faults(run.path)]
        if target == SUPERVISOR and run.path.exists() and not _is_whole(run.path, undisturbed.digest):
            faults += _resume_faults(run.path, undisturbed.log)
        whole = _is_whole(run.path, undisturbed.digest)
        if not whole and run.path.exists():
            faults.append(f"the recording is not that of an undisturbed run: {run.errors}")
        if left:
            faults.append(f"left: {', '.join(left.values())}")
        return Outcome(named_s, gone_s, whole, tuple(faults))


def _everything(count: int, random: Random, undisturbed: Undisturbed) -> int:
    """Kill all processes of runs at once, resume those of which there is a recording, and return how many are wrong."""
    took_s, blank, wrong = [], 0, 0
    for trial in range(count):
        with _run(*undisturbed.words) as run:
            run.await_process(undisturbed.processes[-1])
            after_s = random.uniform(0.0, undisturbed.lasts_s)
            time.sleep(after_s)
            run.kill()
            began_s = time.monotonic()
            if not run.path.exists() or _is_whole(run.path, undisturbed.digest):
                blank += 1
                continue
            faults = _resume_faults(run.path, undisturbed.log)
            took_s.append(time.monotonic() - began_s)
            if faults or not _is_whole(run.path, undisturbed.digest):
                wrong += 1
                print(f"everything killed after {after_s:.2f} s: {', '.join(faults) or 'other bytes'}", flush=True)
        print(f"\reverything {trial + 1} of {count} ", end="", file=sys.stderr, flush=True)
    if took_s:
        print(
            f"everything killed: {count} runs, {blank} of them before the first byte or after the last; resumed "
            f"{len(took_s)} in {sum(took_s) / len(took_s):.2f} s, at most {max(took_s):.2f} s; wrong: {wrong}"
        )
    return wrong


def _resume_faults(path: Path, log: tuple[str, ...]) -> list[str]:
    command = [sys.executable, "-P", "-m", "dynpf_lab.cli.main", "resume", str(path), "--no-page", *log]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    return [f"dynpf resume: {told.stdout}{told.stderr}"] if told.returncode else []


def _send(run: _Run, pid: int | None, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        if pid is not None and run.popen.poll() is None:
            os.kill(pid, number)


def _is_whole(path: Path, digest: str) -> bool:
    if not path.exists():
        return False
    try:
        recording = read_recording(path)
    except RecordingError:
        return False
    return recording.end is not None and recording.end.complete and content_digest(recording) == digest


def _names(target: str) -> tuple[str, str]:
    return f"dynpf run: {target} hangs: ", f"dynpf run: {target} was killed by signal 9"


def _faults(run: _Run, target: str, named_s: float | None, gone_s: float, others: tuple[str, ...]) -> Iterator[str]:
    """Say what is wrong with how a run ended; ``others`` are those who must not be named."""
    errors = run.errors
    if "Traceback" in errors:
        yield f"a traceback: {errors}"
    if any(text in errors for name in others for text in _names(name)):
        yield f"another was named: {errors}"
    if target == SUPERVISOR:
        if gone_s > NAMED_S:
            yield f"the last process has gone after {gone_s:.2f} s"
    elif named_s is None and run.popen.poll() != 0:
        yield f"it was not named: {errors}"
    elif named_s is not None and named_s > NAMED_S:
        yield f"it was named after {named_s:.2f} s"
    if folders := [path.name for path in run.path.parent.glob("dynpf-*")]:
        yield f"left: the folder {', '.join(folders)}"


def _file_faults(path: Path) -> Iterator[str]:
    """Say what is wrong with a recording that is neither whole nor can be mended."""
    if not path.exists():
        return
    _, findings = _told("doctor", str(path), "--json")
    if not json.loads(findings or "{}").get("findings"):
        return
    mended = path.with_name("mended.mcap")
    code, text = _told("recover", str(path), "-o", str(mended))
    if code:
        yield f"dynpf recover: {text}"
        return
    _, findings = _told("doctor", str(mended), "--json")
    for finding in json.loads(findings)["findings"]:
        if "byte" in finding["where"]:
            yield f"the mended recording: {finding}"


def _told(*words: str) -> tuple[int, str]:
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = dynpf(words)
    return code, out.getvalue() or errors.getvalue()


def _cold(words: tuple[str, ...], count: int) -> int:
    """Start runs with an empty cache of kernels on a busy machine, and return how often something was wrong."""
    wrong = 0
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY if count else 0)]
    try:
        for trial in range(count):
            with (
                tempfile.TemporaryDirectory() as cache,
                _run(*words, "--set", "max_ticks=20", NUMBA_CACHE_DIR=cache) as run,
            ):
                code = run.popen.wait()
                if code or "hangs" in run.errors:
                    wrong += 1
                    print(f"cold start {trial}: exit code {code}: {run.errors}", flush=True)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    if count:
        print(f"cold starts: {count}, on a machine with {BUSY} busy processes besides; wrong: {wrong}", flush=True)
    return wrong


if __name__ == "__main__":
    sys.exit(main())
