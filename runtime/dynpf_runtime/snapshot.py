"""Snapshots of a node and its host: when they are taken, and how a new host goes on from one.

They are taken by counted steps and bytes, not by clocks, so that the same lockstep run has the same ones. The budget is
a share of what the node's host sends, whatever the size of the state; only when no snapshot was taken for long is one
taken in any case, because a node goes on from a snapshot by executing all steps since then.
"""

from collections.abc import Sequence
from typing import Protocol

from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX, Frozen, FrozenInbox, pack, unpack

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.gaps import GapWatch
from dynpf_runtime.node import Adopting, Takeover, decode_state

__all__ = ["Snapshots", "freeze_host", "thaw_executor", "thaw_host"]

_OFTEN = 100
"""Steps between two snapshots, at least."""

_RARE = 2000
"""Steps between two snapshots, at most."""

_SENT_PER_BYTE = 128
"""How many bytes the host sends for each byte of a snapshot. Messages become about ten times smaller in a recording,
states hardly smaller: so snapshots have about eight percent of it."""

_FIRST_SENT_PER_BYTE = 64
"""The same for the first snapshot: until there is one, a recorder has to keep all that has been said."""

_OVERHEAD = 500
"""Bytes of a snapshot besides the node's state, about."""

_ENTRY = 250
"""Bytes of a journal entry, about: they depend on the runner, by the length of boots."""


class _Inbox(Protocol):
    """What snapshots ask of an inbox."""

    def freeze(self, now_ns: int) -> FrozenInbox:
        """Return the state between two steps."""

    def thaw(self, frozen: FrozenInbox, now_ns: int) -> None:
        """Restore a state that ``freeze`` returned."""


class Snapshots:
    """Takes the snapshots of one node and its host: executor, gap watch and inbox.

    With ``digests`` one is taken at every so many digests of the state, whatever it costs.
    """

    def __init__(self, executor: Executor, gaps: GapWatch, inbox: _Inbox, digests: int = 0) -> None:
        self._executor, self._gaps, self._inbox = executor, gaps, inbox
        self._every = digests
        self._steps = self._bytes = self._digests = 0  # made and sent since the last snapshot
        self._tried = False  # whether one was made, or would have been too large

    def after(self, entry: JournalEntry, sent: Sequence[Sent], publish_ns: int, now_ns: int = 0) -> Sent | None:
        """Return the snapshot after the step just journalled as ``entry``, in which ``sent`` was sent, if one is due.

        ``now_ns`` is the time by which a realtime inbox holds messages back.
        """
        self._steps += 1
        self._bytes += _ENTRY
        for message in sent:
            self._bytes += len(message.payload)
        if entry.last or not self._due():
            return None
        self._steps = self._bytes = self._digests = 0
        self._tried = True
        snapshot = freeze_host(self._executor, self._gaps, self._inbox, entry, now_ns)
        topic = SNAPSHOT_PREFIX + self._executor.spec.name
        if snapshot is None:
            return None
        try:
            return self._executor.stamp(topic, snapshot, entry.tick, entry.stamp_ns, publish_ns)
        except BadMessageError:  # larger than a message may be
            return None

    def _due(self) -> bool:
        if self._steps >= _RARE:
            return True
        size = len(self._executor.frozen)  # known in steps with a digest, and then compressing it is all that is left
        if size == 0:
            return False
        self._digests += 1
        if self._every:
            return self._digests >= self._every
        first = not self._tried and SNAPSHOT_PREFIX + self._executor.spec.name not in self._executor.sequences()
        enough = (_FIRST_SENT_PER_BYTE if first else _SENT_PER_BYTE) * (size + _OVERHEAD)
        return (first or self._steps >= _OFTEN) and self._bytes >= enough


def freeze_host(
    executor: Executor, gaps: GapWatch, inbox: _Inbox, entry: JournalEntry, now_ns: int = 0
) -> Snapshot | None:
    """Return a snapshot after the step that was journalled last, as ``entry``, or None if it would be too large.

    Raises StepError if the state cannot be encoded.
    """
    topic = SNAPSHOT_PREFIX + executor.spec.name
    sequences = executor.sequences()
    frozen = Frozen(
        sequences={**sequences, topic: sequences.get(topic, 0) + 1},  # the snapshot's own number is taken, too
        expected=gaps.freeze(),
        inbox=inbox.freeze(now_ns),
        state=executor.frozen or executor.freeze(),
    )
    packed = pack(frozen)
    if packed is None:
        return None
    return Snapshot(step=entry.step, tick=entry.tick, chain=executor.chain.hex(), state=packed)


def thaw_host(
    snapshot: Snapshot,
    executor: Executor,
    gaps: GapWatch,
    inbox: _Inbox,
    now_ns: int = 0,
    *,
    takeover: Takeover = Takeover.ITSELF,
) -> None:
    """Let a new executor with its node in its first state, gap watch and inbox go on after the step of a snapshot.

    Raises BadMessageError if the snapshot is none of this node.
    """
    frozen = thaw_executor(snapshot, executor, takeover=takeover)
    gaps.thaw(frozen.expected)
    inbox.thaw(frozen.inbox, now_ns)


def thaw_executor(snapshot: Snapshot, executor: Executor, *, takeover: Takeover = Takeover.ITSELF) -> Frozen:
    """Let a new executor alone go on after the step of a snapshot, and return all that was frozen.

    Raises BadMessageError if the snapshot is none of this node.
    """
    frozen, node = unpack(snapshot.state), executor.node
    try:
        if takeover is Takeover.OTHER and isinstance(node, Adopting):
            node.adopt(decode_state(frozen.state))
        elif takeover is not Takeover.FRESH:
            node.thaw(decode_state(frozen.state))
        chain = bytes.fromhex(snapshot.chain)
    except Exception as error:  # whatever a node says to a state that is none of its own
        name = executor.spec.name
        raise BadMessageError(f"the snapshot after step {snapshot.step} is none of {name}: {error}") from error
    executor.thaw(snapshot.step + 1, chain, frozen.sequences)
    return frozen
