"""Saying: what a node's host publishes, keeps until the recorder has it, and says again."""

from collections.abc import Callable, Container, Generator, Iterator, Sequence
from typing import NamedTuple

from dynpf_protocol.envelope import encode_envelope
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.keys import AGAIN, RECORDER, TICK, data_key
from dynpf_protocol.recall import Piece, encode_recall

from dynpf_runtime.executor import Sent
from dynpf_runtime.machines.effects import NEVER_NS, Put
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.unconfirmed import Unconfirmed

__all__ = ["Saying", "StepSaid", "put_of"]


class StepSaid(NamedTuple):
    """What a host says of a step beside its journal entry: what it has fed to the node itself or found, the node's
    messages, a report of the process if one is due, and that the step has ended."""

    hosted: Sequence[Sent]
    sent: Sequence[Sent]
    report: Put | None
    end: Put


class Saying:
    """What the host says that is a ``member`` of a run; ``realtime`` is the run's clock.

    In lockstep what was lost is said again to all. In realtime it is said again to the recorder alone: others have
    missed it, and go on with what comes now; an old command that is published again might even do harm.
    """

    def __init__(self, member: Membership, *, realtime: bool) -> None:
        self.silent = False  # while the node makes steps that an earlier start has made
        self._member, self._realtime = member, realtime
        self._unconfirmed = Unconfirmed()
        self._returns = 0  # how often a peer had come back when this process last looked

    @property
    def wake_ns(self) -> int:
        """When to say something again."""
        return self._unconfirmed.wake_ns

    @property
    def full(self) -> bool:
        """Whether no more can be kept."""
        return self._unconfirmed.full(self._member.ticks)

    @property
    def urgent(self) -> bool:
        """Whether something is to be said again before anything new."""
        return self._unconfirmed.urgent

    def say(self, put: Put) -> tuple[Put, ...]:
        """Return a message to publish, unless an earlier start has; it is kept until it is confirmed."""
        if self._member.recovers:
            self._unconfirmed.add(self._member.ticks, put)
        return () if self.silent else (put,)

    def step(
        self, said: StepSaid, awaited: Container[str], enter: Callable[[], tuple[JournalEntry, Put]]
    ) -> Generator[Put, None, JournalEntry]:
        """Yield what is to be published of a step, and return its journal entry, which ``enter`` makes.

        In lockstep what other nodes wait for goes first, of the topics ``awaited``, and then the end of the tick. In
        realtime the entry goes before the node's messages: so nobody reads of a step that no journal has.
        """
        hosted, sent, report, end = said
        if self._realtime:
            for message in hosted:
                yield from self.say(put_of(message))
            entry, put = enter()
            yield from self.say(put)
            hosted = ()
        everything = (*hosted, *sent)
        for message in everything:
            if message.topic in awaited:
                yield from self.say(put_of(message))
        ending = [*((report,) if report is not None else ()), end]  # the last report precedes the end of the last tick
        if not self._realtime:
            for put in ending:
                yield from self.say(put)
        for message in everything:
            if message.topic not in awaited:
                yield from self.say(put_of(message))
        if self._realtime:
            for put in ending:
                yield from self.say(put)
        else:
            entry, put = enter()
            yield from self.say(put)
        return entry

    def forget(self) -> None:
        """Forget what has been said: this process takes over, or goes on from a snapshot."""
        self._unconfirmed = Unconfirmed()

    def confirm(self, *, but_last: bool) -> None:
        """Forget what the recorder has in its file, ``but_last`` not the last step."""
        kept = self._member.heartbeats.kept(RECORDER, self._member.name)
        self._unconfirmed.confirm(min(kept, self._member.ticks - 1) if but_last else kept)

    def rouse(self, now_ns: int) -> None:
        """Say again soon what is not confirmed."""
        self._unconfirmed.rouse(now_ns, self._member.ticks)

    def returned(self, now_ns: int) -> bool:
        """Return whether somebody has come back since the last time; then all is said again soon."""
        returns, self._returns = self._returns, self._member.absence.returns
        if self._returns == returns:
            return False
        self.rouse(now_ns)
        return True

    def again(self, now_ns: int, *, over: bool) -> Iterator[Put]:
        """Yield what is to be said again now; ``over`` if the node has made its last step, which all have to know."""
        for put in self._unconfirmed.again(now_ns) if self.wake_ns != NEVER_NS else ():
            if self._realtime:
                yield Put(AGAIN + self._member.name, encode_recall(Piece(*put)))
            if not self._realtime or (over and put.key.startswith(TICK)):
                yield put


def put_of(sent: Sent) -> Put:
    """Return what publishes a message."""
    return Put(data_key(sent.topic, sent.envelope.node), sent.payload, encode_envelope(sent.envelope))
