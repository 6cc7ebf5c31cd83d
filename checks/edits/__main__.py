"""Makes many edits of small recorded runs, and prints what found them: ``python -m checks.edits --edits 10000``."""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path
from random import Random

from dynpf_runtime.progress import show_progress

from checks.edits.judge import Found, judge
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
    counts: Counter[tuple[bool, str, str, Found]] = Counter()
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        runs = small_runs(Path(folder))
        path = Path(folder) / "edited.mcap"
        for number in range(options.edits):
            kind = KINDS[number % len(KINDS)]
            attempts = (
                judge(kind, random.choice(runs), random, path, reseal=random.random() < 0.5) for _ in range(_ATTEMPTS)
            )
            judged = next((attempt for attempt in attempts if attempt is not None), None)
            if judged is None:
                raise ValueError(f"{kind.name}: the runs have nothing to change")
            counts[judged.resealed, kind.what, kind.name, judged.found] += 1
            show_progress(f"{number + 1} of {options.edits} edits")
    show_progress("")
    totals: Counter[tuple[str, str, Found]] = Counter()
    for (reseal, what, name, found), count in sorted(counts.items()):
        right = "chain and seal right" if reseal else "checksums right"
        print(f"{right:<20}  {what:<12}  {name:<36}  {found:<18}  {count:>5}")
        totals[right, what, found] += count
    for (right, what, found), count in sorted(totals.items()):
        print(f"{right:<20}  {what:<12}  {'all':<36}  {found:<18}  {count:>5}")
    return 1 if any(found is Found.SILENT for *_, found in counts) else 0


if __name__ == "__main__":
    sys.exit(main())
