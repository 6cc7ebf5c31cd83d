"""Attacks real runs: `python -m checks.attacks [--times 5] [--only NAME] [--role ROLE [--own]]`.

Prints what became of the runs, by kind of attack, and exits with 1 if one was stalled, wrong or unfinished without
saying so, or, but for what only a certificate prevents, not what it would have been.
"""

import argparse
import sys
from collections import Counter

from checks.attacks.kinds import KINDS, Kind
from checks.attacks.outcome import PLAIN, Fate, attacked, undisturbed

ALWAYS = {Fate.UNTOUCHED}
FORGED = {Fate.UNTOUCHED, Fate.TOLD, Fate.STOPPED, Fate.FALSE_ALARM}


def main() -> int:
    """Attack, and print a row for each kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=1, help="how often each attack is tried")
    parser.add_argument("--only", action="append", help="the attacks whose names have this in them")
    parser.add_argument(
        "--role",
        default=PLAIN,
        help="plain: on plain tcp; nobody: without a certificate; forger: with one of another authority; or whose",
    )
    parser.add_argument("--own", action="store_true", help="speak in the own name of the role, too")
    parser.add_argument("--verbose", action="store_true", help="print what the runs have said")
    options = parser.parse_args()
    kinds = [kind for kind in KINDS.values() if not options.only or any(part in kind.name for part in options.only)]
    expected, total, faults = undisturbed(), Counter[Fate](), 0
    for kind in kinds:
        outcomes = [attacked(kind, options.role, expected, own=options.own) for _ in range(options.times)]
        fates = Counter(outcome.fate for outcome in outcomes)
        total.update(fates)
        wrong = fates.keys() - _allowed(kind, options.role, own=options.own)
        faults += sum(fates[fate] for fate in wrong)
        acts, slowest = sum(outcome.acts for outcome in outcomes), max(outcome.seconds for outcome in outcomes)
        told = ", ".join(f"{count} {fate.value}" for fate, count in fates.items())
        print(f"{kind.name:<45} {told:<30} {acts:6} acts  {slowest:4.1f} s{'  FAULT' * bool(wrong)}", flush=True)
        for outcome in outcomes:
            if options.verbose or outcome.fate in wrong:
                print("    " + outcome.text[-2000:].replace("\n", "\n    "), flush=True)
    print(
        ", ".join(f"{count} {fate.value}" for fate, count in total.items()), f"of {len(kinds)} kinds;", faults, "faults"
    )
    return 1 if faults else 0


def _allowed(kind: Kind, role: str, *, own: bool) -> set[Fate]:
    """Return what may become of a run: who holds a node's key is that node, and may end the run."""
    return FORGED if own or (kind.forged and role == PLAIN) else ALWAYS


if __name__ == "__main__":
    sys.exit(main())
