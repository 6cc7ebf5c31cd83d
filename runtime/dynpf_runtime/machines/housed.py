"""Housed: a node, and what its host holds of it from one step to the next."""

from collections.abc import Mapping

from dynpf_protocol.errors import BadMessageError, RunError
from dynpf_protocol.journal import genesis
from dynpf_protocol.restoring import decode_snapshot
from dynpf_protocol.topics import EVENT_PREFIX

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.inbox import LockstepInbox, RealtimeInbox
from dynpf_runtime.machines.intake import Intake
from dynpf_runtime.machines.roles import Roles
from dynpf_runtime.machines.turns import Turn
from dynpf_runtime.node import Node
from dynpf_runtime.plan import Plan
from dynpf_runtime.snapshot import Snapshots, thaw_host

__all__ = ["Housed"]


class Housed:
    """The node ``node`` of a run of ``plan``, called ``name``, in its first state behind an empty inbox.

    ``boots`` has the boot of each peer; it may change in place.
    """

    def __init__(self, name: str, node: Node, plan: Plan, boot: str, boots: Mapping[str, str]) -> None:
        graph, chain = plan.graph, genesis(name, plan.text)
        self.spec = graph.specs[name]
        self.executor = Executor(node, self.spec, graph.topics, boot, plan.state_digest_ticks, chain=chain)
        self.gaps = GapWatch()
        link = FaultyLink(plan.faults, name, plan.seed)
        self.inbox = (LockstepInbox if plan.clock == "lockstep" else RealtimeInbox)(graph, name, link)
        self.snapshots = Snapshots(self.executor, self.gaps, self.inbox, plan.snapshot_digests)
        self.intake = Intake(Roles(plan, boots), self.inbox)

    def go_on_from(self, payload: bytes) -> int:
        """Go on after the step of a snapshot, and return how many ticks were before; raises RunError if it is none of
        this node.

        The recorder has found it to be of the state that the journal has.
        """
        try:
            snapshot = decode_snapshot(payload)
            thaw_host(snapshot, self.executor, self.gaps, self.inbox)
        except BadMessageError as error:
            raise RunError(f"{self.spec.name} cannot come back: {error}") from error
        return snapshot.tick + 1

    def reports(self, turn: Turn, wall_ns: int) -> list[Sent]:
        """Return reports of the gaps in what a step reads, and of those in a live robot's records."""
        executor, (tick, *_), stamp_ns = self.executor, turn.ready, turn.stamp_ns
        found = notice_gaps(executor, self.gaps, turn.ready, stamp_ns, wall_ns)
        topic = EVENT_PREFIX + self.spec.name
        return [*found, *(executor.stamp(topic, gap, tick, stamp_ns, wall_ns) for gap in turn.gaps)]
