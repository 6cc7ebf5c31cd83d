"""Health of the estimate, judged at each update and once a second while there is no update."""

import math
from collections.abc import Sequence
from typing import Any

import msgspec
from dynpf_protocol.messages import FilterHealth, HealthFigures, Log, LogLevel, timestamp
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, State

from dynpf.filters.health import Health, HealthMemory, HealthParams, Signs, Status, Verdict
from dynpf.filters.models import Outcome
from dynpf_systems.rooms.localization.localizers import Found
from dynpf_systems.rooms.localization.readings import size_of

__all__ = ["HealthWatch", "signs_of"]

JUDGED = Every(1.0)


class HealthWatch:
    """The health monitor with its memory between steps; ``report`` is its last verdict, None before the first."""

    def __init__(self, params: HealthParams, name: str) -> None:
        self._judge = Health(params)
        self._name = name
        self._memory = self._judge.begin()
        self._judged_ns: int | None = None
        self.report: FilterHealth | None = None

    def begin_anew(self) -> None:
        """Forget all that was judged, but for the last status, whose change is told."""
        self._memory, self._judged_ns = self._judge.begin(), None

    def due(self, stamp_ns: int) -> bool:
        """Return whether a judgement without an update is due."""
        return JUDGED.due(stamp_ns, self._judged_ns)

    def judge(self, signs: Signs, stamp_ns: int) -> list[Output]:
        """Judge by the signs; return a message if the status changed, or if the first status is not tracking."""
        before = Status.TRACKING if self.report is None else self.report.status
        self._memory, verdict = self._judge.assess(self._memory, signs)
        self._judged_ns = stamp_ns
        self.report = _report(verdict)
        return [] if verdict.status == before else [self._warning(verdict, stamp_ns)]

    def freeze(self) -> dict[str, Any]:
        """Return the memory and the last verdict."""
        report = None if self.report is None else msgspec.to_builtins(self.report)
        return {"memory": list(self._memory), "judged_ns": self._judged_ns, "report": report}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._memory = HealthMemory(*state["memory"])
        self._judged_ns = state["judged_ns"]
        self.report = None if state["report"] is None else msgspec.convert(state["report"], FilterHealth)

    def _warning(self, verdict: Verdict, stamp_ns: int) -> Output:
        level = LogLevel.INFO if verdict.status in {Status.TRACKING, Status.UNCERTAIN} else LogLevel.WARNING
        text = f"the estimate is {verdict.status}: {verdict.reason}"
        return Output("log", Log(timestamp=timestamp(stamp_ns), level=level, message=text, name=self._name))


def signs_of(found: Found, readings: Sequence[Any], modes: tuple[float, ...] | None) -> Signs:
    """Return the signs for the judge: from the result of an update by ``readings``, and the belief's ``modes``."""
    sizes = [size_of(reading) for reading in readings]
    outright = sum(int(size) for size, outcome in zip(sizes, found.outcomes, strict=True) if outcome is Outcome.REFUSED)
    return Signs(
        covariance=found.estimate.covariance,
        n_eff=found.share,
        n=1,
        log_evidence=found.log_evidence,
        readings=found.readings,
        refused=max(outright, sum(int(size) for size in sizes) - found.readings),
        modes=modes,
        jump=found.jump,
        unfit=found.unfit,
        unexplained=found.unexplained,
        unheard=found.unheard,
    )


def _report(verdict: Verdict) -> FilterHealth:
    known = {name: value for name, value in verdict.figures._asdict().items() if math.isfinite(value)}
    return FilterHealth(status=verdict.status.value, reason=verdict.reason, figures=HealthFigures(**known))
