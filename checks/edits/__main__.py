"""Makes many edits of small recorded runs, and prints what found them: ``python -m checks.edits --edits 10000``."""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path
from random import Random

from dynpf_runtime.progress import show_progress

from checks.edits.judge import Found, Judge, Level
from checks.edits.kinds import KINDS
from checks.edits.runs import small_runs

_ATTEMPTS = 100  # not every place has what a kind of edit changes


def main() -> int:
    """Make the edits and return 1 if one was silent."""
    parser = argparse.ArgumentParser(prog="python -m checks.edits", description=__doc__)
    parser.add_argument("--edits", type=int, default=1000, help="how many (1000)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random = Random(options.seed)
    counts: Counter[tuple[Level, str, str, Found]] = Counter()
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        runs = small_runs(Path(folder))
        judge, levels = Judge(Path(folder)), [*Level]
        for number in range(options.edits):
            kind = KINDS[number % len(KINDS)]
            level = levels[number // len(KINDS) % len(levels)]
            attempts = (judge.judge(kind, random.choice(runs), random, level) for _ in range(_ATTEMPTS))
            judged = next((attempt for attempt in attempts if attempt is not None), None)
            if judged is None:
                raise ValueError(f"{kind.name}: the runs have nothing to change")
            counts[level, kind.what, kind.name, judged.found] += 1
            show_progress(f"{number + 1} of {options.edits} edits")
    show_progress("")
    totals: Counter[tuple[Level, str, Found]] = Counter()
    for (level, what, name, found), count in sorted(counts.items()):
        print(f"{level:<20}  {what:<12}  {name:<36}  {found:<18}  {count:>5}")
        totals[level, what, found] += count
    for (level, what, found), count in sorted(totals.items()):
        print(f"{level:<20}  {what:<12}  {'all':<36}  {found:<18}  {count:>5}")
    return 1 if any(found is Found.SILENT for *_, found in counts) else 0


if __name__ == "__main__":
    sys.exit(main())
