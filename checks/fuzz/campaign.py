"""Many cases, in blocks, each in a process of its own: what takes a process down is a fault, and the next one begins.

A corpus grows: a hostile recording that brings about an outcome not seen before is kept, and edited further. What a
fault came of is kept beside it, in the folder ``faults``.
"""

import hashlib
import json
import os
import re
import resource
import shutil
import sys
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple, TextIO

from checks.fuzz.cases import Workshop, files_case
from checks.fuzz.payloads import payload_case
from checks.fuzz.sources import Sources
from checks.fuzz.subjects import command
from checks.fuzz.trial import Outcome, Verdict, tried, tried_together

__all__ = ["Campaign", "Plan", "one_case"]

_FILES_A_BLOCK, _PAYLOADS_A_BLOCK = 1000, 20_000
_PAYLOADS_TOGETHER = 1000
_MOST_KEPT = 2000  # files of the corpus
_LARGEST_KEPT = 200_000  # bytes
_ADDRESS_SPACE = 3 * 2**30  # bytes, above what the process has; the machine is shared


class Plan(NamedTuple):
    """How many cases, and which."""

    files: int
    payloads: int
    seed: int = 0
    first: int = 0


class Campaign:
    """The run of a plan. ``faults`` has the cases of each fault, by subject and text, ``failures`` of failed steps."""

    def __init__(self, plan: Plan, sources: Sources, folder: Path, corpus: Path) -> None:
        self.plan, self._sources, self._folder, self._corpus = plan, sources, folder, corpus
        self.counts: defaultdict[str, Counter[Verdict]] = defaultdict(Counter)
        self.faults: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
        self.failures: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
        self.slowest: defaultdict[str, float] = defaultdict(float)
        self.largest: defaultdict[str, int] = defaultdict(int)
        self._inputs = {"file": 0, "payload": 0}

    def run(self) -> None:
        """Run all blocks; each tells on standard error how far it is."""
        self._corpus.mkdir(exist_ok=True, parents=True)
        for path in self._sources.recordings.values():
            for name in ("doctor", "info", "metrics", "replay", "fit"):
                tried(partial(command, name, path))  # so that the processes of the blocks have loaded what they need
        for kind, total, size in (
            ("file", self.plan.files, _FILES_A_BLOCK),
            ("payload", self.plan.payloads, _PAYLOADS_A_BLOCK),
        ):
            for first in range(self.plan.first, self.plan.first + total, size):
                self._block(kind, range(first, min(first + size, self.plan.first + total)))
                print(f"{kind} {first + size}: {len(self.faults)} kinds of faults", file=sys.stderr)

    def _block(self, kind: str, numbers: range) -> None:
        """Run cases in a child, and go on after the one that it dies of."""
        while numbers:
            read, write = os.pipe()
            child = os.fork()
            if child == 0:
                os.close(read)
                os._exit(self._as_child(kind, numbers, write))
            os.close(write)
            last = numbers.start
            with open(read, encoding="utf-8") as lines:  # noqa: PTH123 - a pipe
                for line in lines:
                    last = self._take(kind, line)
            _, status = os.waitpid(child, 0)
            if status == 0:
                return
            self.faults[kind, f"the process died, status {status}"].append(f"{kind} {last}")
            numbers = range(last + 1, numbers.stop)

    def _as_child(self, kind: str, numbers: range, write: int) -> int:
        limit_memory()
        folder = self._folder / "work"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        workshop = Workshop(self._sources, folder, tuple(sorted(self._corpus.glob("*.mcap"))))
        with open(write, "w", encoding="utf-8", buffering=1) as out:
            try:
                if kind == "file":
                    self._files(numbers, workshop, out)
                else:
                    self._payloads(numbers, out)
            except Exception:
                traceback.print_exc()
                return 1
        return 0

    def _files(self, numbers: range, workshop: Workshop, out: TextIO) -> None:
        for number in numbers:
            print(json.dumps({"number": number, "inputs": 1}), file=out)
            for trial in files_case(number, self.plan.seed, workshop):
                outcome = tried(trial.action, trial.limits)
                self._keep(workshop.folder, trial.subject, outcome)
                if outcome.verdict is Verdict.FAULT:
                    self._set_aside(workshop.folder, number)
                print(json.dumps({"number": number, "subject": trial.subject, "outcome": outcome}), file=out)

    def _payloads(self, numbers: range, out: TextIO) -> None:
        for first in range(numbers.start, numbers.stop, _PAYLOADS_TOGETHER):
            some = numbers[first - numbers.start :][:_PAYLOADS_TOGETHER]
            print(json.dumps({"number": first, "inputs": len(some)}), file=out)
            subjects: dict[int, str] = {}

            def made(number: int, subjects: dict[int, str] = subjects) -> Callable[[], object]:
                subjects[number], action, _ = payload_case(number, self.plan.seed)
                return action

            outcomes = tried_together([partial(made, number) for number in some])
            for number, outcome in zip(some, outcomes, strict=True):
                print(json.dumps({"number": number, "subject": subjects[number], "outcome": outcome}), file=out)

    def _take(self, kind: str, line: str) -> int:
        told = json.loads(line)
        number = int(told["number"])
        if "outcome" not in told:
            self._inputs[kind] += told["inputs"]
            return number
        subject, outcome = told["subject"], Outcome(*told["outcome"])
        self.counts[subject][Verdict(outcome.verdict)] += 1
        self.slowest[subject] = max(self.slowest[subject], outcome.seconds)
        self.largest[subject] = max(self.largest[subject], outcome.bytes)
        if outcome.verdict == Verdict.FAULT:
            cases = self.faults[subject, _kind_of(outcome.text)]
            if not cases:
                print(f"fault: {subject}, {kind} {number}: {outcome.text}", file=sys.stderr)
            cases.append(f"{kind} {number}")
        elif outcome.verdict == Verdict.FAILED:
            self.failures[subject, _kind_of(outcome.text)].append(f"{kind} {number}")
        return number

    def _keep(self, folder: Path, subject: str, outcome: Outcome) -> None:
        """Keep the recording of an outcome whose kind is new."""
        path = folder / "hostile.mcap"
        name = hashlib.sha256(f"{subject} {_kind_of(outcome.text)}".encode(errors="replace")).hexdigest()[:16]
        kept = self._corpus / f"{name}.mcap"
        if kept.exists() or not path.exists() or path.stat().st_size > _LARGEST_KEPT:
            return
        if len([*self._corpus.iterdir()]) < _MOST_KEPT:
            shutil.copyfile(path, kept)

    def _set_aside(self, folder: Path, number: int) -> None:
        """Keep what a trial at fault has read: with a corpus that grows, the number alone does not bring it back."""
        target = self._corpus / "faults" / f"{self.plan.seed}-{number}"
        shutil.copytree(folder, target, dirs_exist_ok=True, ignore=_irregular)

    def table(self) -> str:
        """Return the counts of each subject, and the faults with their cases."""
        titles = f"{'refused':>9}{'accepted':>9}{'failed':>8}{'faults':>8}{'slowest':>9}{'memory':>9}"
        lines = [f"{'':16}{'trials':>9}{titles}"]
        for subject, counts in sorted(self.counts.items()):
            refused, accepted, failed, faults = (
                counts[verdict] for verdict in (Verdict.REFUSED, Verdict.ACCEPTED, Verdict.FAILED, Verdict.FAULT)
            )
            limits = f"{self.slowest[subject]:>7.2f} s{self.largest[subject] / 2**20:>6.0f} MB"
            lines.append(
                f"{subject:16}{sum(counts.values()):>9}{refused:>9}{accepted:>9}{failed:>8}{faults:>8}{limits}"
            )
        for name, found in (("fault", self.faults), ("failed step", self.failures)):
            for (subject, text), cases in sorted(found.items(), key=lambda item: -len(item[1])):
                lines.append(f"{len(cases)} x {name}, {subject}: {text} ({', '.join(cases[:3])})")
        lines.append(f"{self._inputs['file']} files and {self._inputs['payload']} payloads, seed {self.plan.seed}")
        return "\n".join(lines)


def _irregular(folder: str, names: list[str]) -> list[str]:
    """Return the names in a folder of what is neither a file nor a folder, such as a FIFO."""
    paths = {name: Path(folder) / name for name in names}
    return [name for name, path in paths.items() if not path.is_file() and not path.is_dir()]


def _kind_of(text: str) -> str:
    """Return a text without what differs from case to case: values, numbers, names."""
    return re.sub(r"'[^']*'|\"[^\"]*\"|(?<![:a-z_])-?\d[\d.e+-]*|/\S+", "*", text)[:160]


def limit_memory() -> None:
    """Let this process have little more memory than it has, so that a bomb harms it alone."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + _ADDRESS_SPACE, size + _ADDRESS_SPACE))


def one_case(plan: Plan, sources: Sources, folder: Path, corpus: Path, keep: Path | None = None) -> int:
    """Run the plan's first file alone, print the outcome of each trial, and return 1 if there was a fault."""
    limit_memory()
    (work := folder / "work").mkdir()
    workshop = Workshop(sources, work, tuple(sorted(corpus.glob("*.mcap"))))
    faults = 0
    for trial in files_case(plan.first, plan.seed, workshop):
        outcome = tried(trial.action, trial.limits)
        took = f"{outcome.seconds:.3f} s, {outcome.bytes / 2**20:.0f} MB"
        print(f"{trial.subject}: {outcome.verdict}: {outcome.text} ({took})")
        faults += outcome.verdict is Verdict.FAULT
        for path in work.glob("hostile*"):
            if keep is not None:
                shutil.copyfile(path, keep)
    return 1 if faults else 0
