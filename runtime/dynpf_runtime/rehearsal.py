"""Rehearsal: runs the first ticks of a plan once per machine, so that all kernels are compiled before the run begins.

Compiling takes seconds. A process that compiles during a run looks as if it hung.
"""

import contextlib
import hashlib
from collections.abc import Sequence
from itertools import islice

from dynpf_protocol.errors import RunError

from dynpf.kernels.compiler import cache_folder
from dynpf_runtime.inline import run_inline
from dynpf_runtime.plan import Plan
from dynpf_runtime.source import LogRecord

__all__ = ["rehearse_run"]

_TICKS = 5
_RECORDS = 100


def rehearse_run(plan: Plan, log: Sequence[LogRecord]) -> None:
    """Run the first ticks of ``plan`` in this process, unless nodes of the same kinds have been rehearsed before.

    Errors of nodes are suppressed here: the run itself will report them.
    """
    folder = cache_folder()
    if folder is None:
        return
    kinds = " ".join(sorted({spec.kind for spec in plan.graph.specs.values()}))
    done = folder / f"rehearsed-{hashlib.sha256(kinds.encode()).hexdigest()[:16]}"
    if done.exists():
        return
    with contextlib.suppress(RunError):
        run_inline(plan._replace(max_ticks=_TICKS), list(islice(log, _RECORDS)))
        done.touch()
