"""``python -m checks.fuzz``: hostile files and payloads, and a table of what came of them; exits 1 at a fault."""

import argparse
import sys
import tempfile
from pathlib import Path

from checks.fuzz.campaign import Campaign, Plan, one_case
from checks.fuzz.sources import sources


def main() -> int:
    parser = argparse.ArgumentParser(prog="checks.fuzz", description="Does hostile input raise, stall or blow up?")
    parser.add_argument("--files", type=int, default=1000, metavar="N", help="hostile files (1000)")
    parser.add_argument("--payloads", type=int, default=10_000, metavar="N", help="hostile payloads (10,000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first case (0)")
    parser.add_argument("--case", type=int, metavar="N", help="only this file, with each trial, and what came of it")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="where the file of --case is kept")
    parser.add_argument("--corpus", type=Path, default=Path(".fuzz"), metavar="FOLDER", help="grows over runs (.fuzz)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dynpf-fuzz-") as folder:
        (sound := Path(folder) / "sound").mkdir()
        made = sources(sound)
        if options.case is not None:
            plan = Plan(files=1, payloads=0, seed=options.seed, first=options.case)
            return one_case(plan, made, Path(folder), options.corpus, options.keep)
        plan = Plan(files=options.files, payloads=options.payloads, seed=options.seed, first=options.first)
        campaign = Campaign(plan, made, Path(folder), options.corpus)
        campaign.run()
    print(campaign.table())
    return 1 if campaign.faults else 0


if __name__ == "__main__":
    sys.exit(main())
