"""The seat of a node in a lockstep run inside one process: the node with its inbox, executor, journal and snapshots."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from dynpf_protocol.codec import decode
from dynpf_protocol.control import Outcome, TickDone
from dynpf_protocol.journal import JournalEntry, genesis
from dynpf_protocol.messages import Snapshot

from dynpf_runtime.executor import Executor, Sent, Unsent
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.inbox import LockstepInbox, Ready
from dynpf_runtime.node import Received, Takeover
from dynpf_runtime.plan import Plan
from dynpf_runtime.snapshot import Snapshots, freeze_host, thaw_host
from dynpf_runtime.source import LogRecord

__all__ = ["Made", "Seat"]


class Made(NamedTuple):
    """The result of a step: the end of the tick, the messages, the journal entry, and a snapshot if one is due."""

    done: TickDone
    sent: tuple[Sent, ...]
    entry: JournalEntry
    snapshot: Sent | None


class Seat:
    """The seat of the node that ``spec`` describes in a run of ``plan``, under one boot."""

    def __init__(self, spec: NodeSpec, plan: Plan, boot: str) -> None:
        self.name, self.reads, self.boot = spec.name, spec.reads, boot
        self.topics = plan.graph.topics
        chain = genesis(spec.name, plan.text)
        self._executor = Executor(spec.build(), spec, self.topics, boot, plan.state_digest_ticks, chain=chain)
        self._gaps = GapWatch()
        link = FaultyLink(plan.faults, spec.name, plan.seed, plan.left_out)
        self.inbox = LockstepInbox(plan.graph, spec.name, link)
        self._snapshots = Snapshots(self._executor, self._gaps, self.inbox, plan.snapshot_digests)

    def take(self, stamp_ns: int = 0) -> Ready:
        """Return the next step's inputs, which are complete at the node's turn in the tick."""
        ready = self.inbox.take(stamp_ns)
        assert ready is not None, f"{self.name} lacks an input of tick {self.inbox.tick}"
        return ready

    def let_in(
        self, acts: Sequence[LogRecord], tick: int, stamp_ns: int
    ) -> tuple[tuple[Sent, ...], tuple[Received, ...]]:
        """Return what a person does in a tick as messages of the source, and those that its node reads."""
        found = [(act.topic, decode(act.topic, act.payload, self.topics)) for act in acts]
        return self._executor.let_in(found, tick, stamp_ns, 0)

    def step(self, ready: Ready, stamp_ns: int, fed: Sequence[Sent], *, last: bool) -> Made:
        """Run a step; ``fed`` are the records of a log that the source publishes in it."""
        events = notice_gaps(self._executor, self._gaps, ready, stamp_ns, 0)
        executed = self._executor.step(ready.tick, stamp_ns, ready.inputs, 0)
        finished = executed.finished
        last = last or finished
        hosted = (*fed, *events)
        entry = self._executor.journal(ready.tick, stamp_ns, ready.inputs, executed.sent, hosted=hosted, last=last)
        sent = (*hosted, *executed.sent)
        done = self._done(ready.tick, stamp_ns, sent, last=last, finished=finished)
        return Made(done, sent, entry, self._snapshots.after(entry, sent, 0))

    def step_unsent(
        self, ready: Ready, stamp_ns: int, fed: Sequence[Sent], *, last: bool
    ) -> tuple[TickDone, tuple[Sent | Unsent, ...]]:
        """Run a step without a journal entry; return its TickDone and the messages."""
        events = notice_gaps(self._executor, self._gaps, ready, stamp_ns, 0)
        results, finished = self._executor.step_unsent(ready.tick, stamp_ns, ready.inputs)
        sent: tuple[Sent | Unsent, ...] = (*fed, *events, *results)
        return self._done(ready.tick, stamp_ns, sent, last=last or finished, finished=finished), sent

    def freeze(self, entry: JournalEntry) -> Snapshot | None:
        """Return a snapshot after the last step, journalled as ``entry``, or None if it would be too large."""
        return freeze_host(self._executor, self._gaps, self.inbox, entry)

    def thaw(self, snapshot: Snapshot, takeover: Takeover = Takeover.ITSELF) -> None:
        """Go on after the step of a snapshot; the inbox then needs what was sent and not consumed before it.

        Raises BadMessageError if the snapshot is none of this node.
        """
        thaw_host(snapshot, self._executor, self._gaps, self.inbox, takeover=takeover)

    def _done(self, tick: int, stamp_ns: int, sent: Sequence[Sent | Unsent], *, last: bool, finished: bool) -> TickDone:
        executor = self._executor
        counts = dict(Counter(message.topic for message in sent))
        outcome = Outcome.DONE if finished else None
        return TickDone(self.name, executor.boot, executor.steps - 1, tick, stamp_ns, counts, last, outcome)
