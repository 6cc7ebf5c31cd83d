"""Asks why of every planted run: ``python -m checks.why [CASE ...]``; exit code 1 if one is not explained rightly."""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

from dynpf_experiments.why.asking import Effort, ask_why
from dynpf_experiments.why.search import WIDEST

from checks.why.cases import CASES


def main() -> int:
    """Print a line for each run, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"some of {', '.join(CASES)} (default: all)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="ask so often, each time with other futures")
    options = parser.parse_args()
    if unknown := sorted({*options.cases} - {*CASES}):
        parser.error(f"{', '.join(unknown)}: expected some of {', '.join(CASES)}")
    wrong = 0
    for name in options.cases or CASES:
        case = CASES[name]
        with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
            recording = case.record(Path(folder))
            planted = case.planted(recording)
            for seed in range(1, options.seeds + 1):
                began_s = time.monotonic()
                effort = Effort(jobs=os.cpu_count() or 1, seed=seed)
                answer = ask_why(recording, case.when, effort, allow_code=case.allow_code)
                found = answer.reasons.interval
                right = case.named(answer) and found is not None and found.width <= WIDEST
                right = right and found is not None and found.first <= planted[1] and found.last >= planted[0]
                wrong += not right
                told = "nothing" if found is None else f"ticks {found.first} to {found.last}"
                print(
                    f"{'right' if right else 'WRONG'}  {name}: planted in {planted[0]} to {planted[1]}, failed in "
                    f"{answer.failure.tick}, found {told}, {answer.reasons.futures} futures, "
                    f"{time.monotonic() - began_s:.0f} s"
                )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
