"""Reporting: what a node's host says of itself, beside the messages of its node: texts, and how long steps took."""

from dynpf_protocol.messages import Diagnostics, Log, LogLevel, timestamp

from dynpf_runtime.executor import Executor
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.machines.events import Now
from dynpf_runtime.machines.gauges import Gauges
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.saying import put_of

__all__ = ["Reporting"]

REPORT_NS = 1_000_000_000


class Reporting:
    """The reports of a host that is a ``member`` of a run."""

    def __init__(self, member: Membership, gauges: Gauges) -> None:
        self._member, self._gauges = member, gauges
        self._step_time_s = 0.0
        self._due_ns = 0
        self._began_s = 0.0
        self.stamp_ns = 0  # of the last step

    def begins(self, tick: int, stamp_ns: int) -> None:
        """Note that a step begins."""
        self.stamp_ns = stamp_ns
        self._gauges.stepping(tick)
        self._began_s = self._gauges.stopwatch_s()

    def ends(self) -> None:
        """Note that the node has made the step."""
        self._step_time_s += self._gauges.stopwatch_s() - self._began_s

    def due(self, now_ns: int) -> bool:
        """Return whether it is time for diagnostics."""
        return now_ns >= self._due_ns

    def diagnostics(self, executor: Executor, now: Now) -> Put:
        """Return the diagnostics of the process."""
        self._due_ns = now.monotonic_ns + REPORT_NS
        message = Diagnostics(
            node=self._member.name,
            steps=executor.steps,
            step_time_s=self._step_time_s,
            refused=dict(self._member.refusals.counts),
            queue=self._gauges.waiting(),
        )
        return self._stamped("diagnostics", message, executor, now)

    def text(self, level: LogLevel, text: str, executor: Executor, now: Now) -> Put:
        """Return a text for the recording."""
        message = Log(timestamp=timestamp(self.stamp_ns), level=level, message=text, name=self._member.name)
        return self._stamped("notice", message, executor, now)

    def _stamped(self, topic: str, message: Diagnostics | Log, executor: Executor, now: Now) -> Put:
        return put_of(executor.stamp(topic, message, self._member.ticks, self.stamp_ns, now.wall_ns))
