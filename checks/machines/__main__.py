"""``python -m checks.machines [arm64|old-x86]``: exits 1 if any job comes out otherwise under any setting."""

import argparse
import os
import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from dynpf_formats.recording.reader import read_recording
from dynpf_lab.references.table import CHECKOUT
from dynpf_protocol.errors import UsageError

from checks.machines.controls import PROCESSOR
from checks.machines.debian import CACHE
from checks.machines.interpreters import EMULATED, emulated, further_pythons
from checks.machines.jobs import LOGS, REFERENCE, chosen
from checks.machines.report import Row, details, row_of, table, verdict
from checks.machines.runs import Difference, Outcome, compared, differences, processor, run
from checks.machines.settings import DEFAULT, Processor, Setting, processor_settings, python_settings
from checks.machines.worker import Done

RECORDED = Setting("recordings/ against default", {}, ())


def main() -> int:
    parser = argparse.ArgumentParser(prog="checks.machines", description="Are the bytes the same on every machine?")
    parser.add_argument("machine", nargs="?", choices=list(EMULATED), help="emulated; else the settings of this one")
    parser.add_argument("--jobs", nargs="*", default=[], metavar="JOB", help="those whose names begin so; else all")
    parser.add_argument("--settings", nargs="*", default=[], metavar="NAME", help="those that begin so; else all")
    parser.add_argument("--cpu", default="", metavar="MODEL", help="QEMU's name of the processor that is emulated")
    args = parser.parse_args()
    try:
        jobs = [job.name for job in chosen(args.jobs)]
        return _matrix(args.machine, args.cpu, jobs, tuple(args.settings))
    except (UsageError, ValueError) as error:
        print(f"checks.machines: {error}", file=sys.stderr)
        return 2


def _matrix(machine: str | None, model: str, jobs: Sequence[str], names: tuple[str, ...]) -> int:
    folder = CACHE / "runs" / (machine or "processor")
    default = _run(DEFAULT, jobs, folder)
    if default.told is None or default.failure:
        raise UsageError(f"the default run failed: {default.failure}; {default.folder / 'stderr.txt'} tells more")
    rows = [row_of(default, default._replace(setting=RECORDED), _against_recordings(default))]
    if machine is None:
        settings = _settings(processor(default.told), names)
    else:
        other = emulated(machine, model)
        settings = [Setting(other.name, {}, PROCESSOR, other, other.kernels)]
    for setting in settings:
        outcome = _run(setting, jobs, folder)
        rows.append(row_of(default, outcome, differences(default, outcome, jobs)))
        if not rows[-1].different:
            shutil.rmtree(outcome.folder)
    return _report(rows, default)


def _settings(here: Processor, names: tuple[str, ...]) -> list[Setting]:
    """Return the settings whose names begin with one of ``names``, all if there is none; raises UsageError."""
    known = list(processor_settings(here))
    if not names or _unknown(names, known):  # further Pythons may have to be downloaded
        known += python_settings(further_pythons())
    if unknown := _unknown(names, known):
        told = ", ".join(one.name for one in known)
        raise UsageError(f"no setting begins with {', '.join(unknown)}; settings here: {told}")
    return [one for one in known if not names or one.name.startswith(names)]


def _unknown(names: tuple[str, ...], settings: Sequence[Setting]) -> list[str]:
    return [name for name in names if not any(one.name.startswith(name) for one in settings)]


def _run(setting: Setting, jobs: Sequence[str], folder: Path) -> Outcome:
    def show(one: Done, seconds: float) -> None:
        if setting.interpreter is not None:
            print(f"  {seconds:6.0f} s  {one.job}  {one.error}".rstrip(), flush=True)

    print(f"{setting.name} ...", flush=True)
    return run(setting, jobs, folder / re.sub(r"[^\w.-]+", "-", setting.name), show)


def _against_recordings(default: Outcome) -> list[Difference]:
    """Return the jobs in which the default run failed, and the references that it does not reproduce."""
    found = [Difference(job, (), done.error) for job, done in default.done.items() if done.error]
    for job in (name for name, done in default.done.items() if name.startswith(REFERENCE) and done.digest):
        recorded = CHECKOUT / "recordings" / f"{job.removeprefix(REFERENCE)}.mcap"
        if recorded.is_file():
            one = compared(job, read_recording(recorded), read_recording(default.folder / f"{job}.mcap"))
            found += [one] if one.where or one.note else []
    return found


def _report(rows: Sequence[Row], default: Outcome) -> int:
    for row in rows:
        if row.different:
            print(f"\n{row.outcome.setting.name}:", *details(row), sep="\n")
    print(f"\n{table(rows)}\n")
    absent = [name for name, done in default.done.items() if done.absent]
    if absent:
        places = ", ".join(str(Path(place)) for place in LOGS.values() if not (CHECKOUT / place).exists())
        print(f"Not run, for the logs are not here: {', '.join(absent)} ({places})")
    print(verdict(rows))
    lacking = bool(absent) and bool(os.environ.get("CI"))
    return int(any(row.different or row.outcome.failure for row in rows) or lacking)


if __name__ == "__main__":
    sys.exit(main())
