"""Replays a part of a run: from a snapshot before it, and from the chunks of the file that it needs.

The state of the snapshot has to agree with its digest in the journal, or, where the entry has none, with the next ones
by what is executed from it; the chain of digests is computed from the snapshot on. What is before the snapshot, and
what hosts do, is not executed.
"""

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

from dynpf_formats.recording.journals import messages_of
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.seek import Indexed, Moment, NoIndexError, chunk_at, origins
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, chain_after, genesis

from dynpf_runtime.plan import Plan
from dynpf_runtime.replay import Mismatch, MissingMessageError, Replayed, Span, replay_node

__all__ = ["ReplayedPart", "replay_part"]

_MARGIN = 1  # chunks before and after those that have the steps
_WIDER = 4  # times as many, if a message is in none of them


class ReplayedPart(NamedTuple):
    """The result of replaying a part of one node, and the step of the snapshot that it went on from, or None."""

    outcome: Replayed
    snapshot: int | None


def replay_part(indexed: Indexed, plan: Plan, name: str, first: Moment | None, last: Moment | None) -> ReplayedPart:
    """Replay the steps of a node from the moment ``first`` to the moment ``last``; None: the beginning, the end.

    Raises NoIndexError if that needs more than the file's index, UsageError if the recording lacks an input.
    """
    found = origins(indexed, name, first) if first is not None else iter(())
    for origin in chain(found, (None,)):  # the next snapshot is looked for only if the node refuses the last one
        try:
            outcome = _replayed(indexed, plan, name, Span(origin, first, last))
        except BadMessageError:
            if origin is None:
                raise
            continue  # a state that agrees with its digest, and that the node refuses
        return ReplayedPart(outcome, None if origin is None else origin.snapshot.step)
    raise AssertionError("without a snapshot there is none to refuse")


def _replayed(indexed: Indexed, plan: Plan, name: str, span: Span) -> Replayed:
    low = 0 if span.origin is None else span.origin.chunk
    high = indexed.chunks - 1 if span.last is None else chunk_at(indexed, name, span.last)
    margin = _MARGIN
    while True:
        recording = indexed.part(low - margin, high + margin)
        whole = low <= margin and high + margin >= indexed.chunks - 1
        try:
            outcome = replay_node(recording, plan, name, span=span)
        except MissingMessageError:
            if whole:
                raise
        else:
            if whole or outcome.mismatch is None or outcome.mismatch.field != "message":
                _check_reached(indexed, recording, name, span.last)
                return outcome._replace(mismatch=outcome.mismatch or _broken_chain(recording, name, span))
        margin *= _WIDER


def _covered(recording: Recording, name: str, span: Span) -> Iterator[tuple[str, JournalEntry]]:
    """Yield boot and entry of the steps of a span that the part of a recording has."""
    boots = [boot for node, boot in recording.journals() if node == name]
    begin = 0 if span.origin is None else span.origin.snapshot.step + 1
    for boot in boots if span.origin is None else boots[boots.index(span.origin.boot) :]:
        for entry in recording.journal(name, boot):
            if span.last is not None and span.last.before(entry):
                return
            if span.origin is None or boot != span.origin.boot or entry.step >= begin:
                yield boot, entry


def _check_reached(indexed: Indexed, recording: Recording, name: str, last: Moment | None) -> None:
    """Raise NoIndexError if the chunks end before the moment ``last``: then the index has not named all of them."""
    boots = [boot for node, boot in recording.journals() if node == name]
    final = next(reversed([*recording.journal(name, boots[-1])]), None) if boots else None
    end = None if indexed.end is None else indexed.end.nodes.get(name)
    if final is None or not ((last is not None and last.before(final)) or (end is not None and end.tick == final.tick)):
        raise NoIndexError(f"{indexed.path}: its index does not lead to the end of the journal of {name}")


def _broken_chain(recording: Recording, name: str, span: Span) -> Mismatch | None:
    """Return the first chain value that does not follow from the one before it and what is in the recording."""
    value = (
        genesis(name, recording.header.scenario) if span.origin is None else bytes.fromhex(span.origin.snapshot.chain)
    )
    for boot, entry in _covered(recording, name, span):
        value = chain_after(value, boot, entry, messages_of(recording, name, boot, entry) or [])
        if entry.chain and entry.chain != value.hex():
            return Mismatch(name, JOURNAL_PREFIX + name, entry.tick, entry.step, "chain", entry.chain, value.hex())
    return None
