"""The ledger of a recorder: which messages belong to the run, by what their senders say of each step.

A step of a node is written when the node's end of the tick and its journal entry are here and agree. Together they say
which messages belong to it; what else has come for it is dropped. Where two different messages claim one place in the
run, the first is kept, and the run is *doubtful*: somebody speaks in a node's name, and nothing here tells who is who.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from typing import NamedTuple, NoReturn

from dynpf_protocol.codec import decode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import OrderError, ProtocolError, RepeatError, TooLargeError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_protocol.topics import is_act
from msgspec.structs import replace

from dynpf_runtime.machines.consumption import Consumption
from dynpf_runtime.machines.effects import Record
from dynpf_runtime.machines.realtime_window import Done, RealtimeWindow, done_of
from dynpf_runtime.machines.roles import MOST_BYTES_OF_A_TICK, MOST_OF_A_TICK, Roles
from dynpf_runtime.machines.steps import NodeSteps, OpenStep, PastStep, PlaceInTopic, counts_of, digest_of, first_of
from dynpf_runtime.machines.window import Window
from dynpf_runtime.plan import Plan

__all__ = ["Ledger", "Place"]

_CLAIMS = 16
"""How many different ends or entries of one step are kept at most."""

_EARLY = 10_000
"""How many messages that came too early are remembered at most."""


class Dropped(NamedTuple):
    """A message that is not part of the run, though it might have been."""

    topic: str
    error: OrderError


class Place(NamedTuple):
    """How far a node has come: steps written, steps of which it has said that they have ended, and its last step.

    ``numbers`` has the next one of each topic that its host writes at any time.
    """

    written: int
    said: int
    last: int | None
    numbers: dict[str, int]


class Ledger:
    """The steps of all nodes of a run of ``plan``; ``roles`` has checked what comes here.

    Each method yields the records to write.
    """

    def __init__(self, plan: Plan, roles: Roles) -> None:
        self._roles = roles
        self._nodes = {name: NodeSteps(plan.graph.unread(name)) for name in plan.graph.nodes}
        self._consumption = Consumption(plan)
        self._realtime = plan.clock == "realtime"
        self.window = RealtimeWindow(plan.graph) if self._realtime else Window(plan.graph)
        self.patient = False  # whether what has not come will be said again
        self.rebuilt = False  # from a recording, which does not have why the run's last step was the last
        self.ticks = 0  # written of every node
        self.written = 0  # steps of all nodes
        self.stamp_ns = 0
        self.messages = 0
        self.outcome = ""  # why the last step was the last, by the source
        self.doubt = ""  # why the run is doubtful
        self.split = False  # whether it is doubtful which tick is the last: then the run cannot end by itself
        self.dropped: list[Dropped] = []
        self.over: dict[str, int] = {}  # the nodes of whose last step the end of the tick is here, and that tick

    @property
    def names(self) -> Collection[str]:
        """The nodes of the run."""
        return self._nodes.keys()

    @property
    def source(self) -> str:
        """The node that is the run's clock."""
        return self._roles.source

    @property
    def ended(self) -> bool:
        """Whether the last step of every node is written, and why it was the last is known."""
        return all(node.ended for node in self._nodes.values()) and not (self.rebuilt and not self.outcome)

    @property
    def ending(self) -> bool:
        """Whether the last step of every node is written, or its end of that tick is here."""
        return len(self.over) == len(self._nodes)

    @property
    def finished(self) -> set[str]:
        """The nodes whose last step is written."""
        return {name for name, node in self._nodes.items() if node.ended}

    def place(self, name: str) -> Place:
        """Return how far a node has come."""
        node = self._nodes[name]
        said, last = node.written, node.written - 1 if node.ended else None
        here = node.open.get(node.written)
        if here is not None and here.ends:
            said, last = said + 1, node.written if here.ends[0].last else None
        written = node.written
        if node.ended and self._roles.source == name and self.rebuilt and not (self.outcome or self._realtime):
            written -= 1  # it is to say once more why; in realtime it says its last step again in any case
        numbers = {topic: seen.following for topic, seen in node.seen.items()}
        return Place(written, said, last, numbers)

    def message(self, name: str, sender: str, envelope: Envelope, payload: bytes) -> tuple[Record, ...]:
        """Take a message; raises OrderError if it is not one that its sender may send now."""
        node, place, record = self._nodes[sender], (name, envelope.sequence), Record(name, envelope, payload)
        if not self._roles.promised(name, sender):
            if not node.seen[name].came(envelope.sequence):
                self._check_open(sender, node, max(envelope.tick, node.written))
            node.seen[name].take(envelope.sequence)
            if name == SNAPSHOT_PREFIX + sender:
                self.window.offer(sender, payload)
            return (self._counted(record),)
        if place in node.missing:
            node.missing.discard(place)
            self.window.found(record, sender)
            return (self._counted(record),)
        if envelope.tick < node.written:
            self._again(node, record)
        try:
            self._check_open(sender, node, envelope.tick)
        except OrderError:
            self._note_early(node, record)
            raise
        if not 0 <= envelope.sequence - node.next[name] < 2 * MOST_OF_A_TICK:
            raise OrderError(f"sequence {envelope.sequence}; expected {node.next[name]} or the next")
        step = node.open[envelope.tick]
        if place in step.messages:
            self._check_claim(name, sender, step.messages[place], record)
        if step.bytes + len(payload) > MOST_BYTES_OF_A_TICK:
            raise TooLargeError(f"{step.bytes} bytes in one tick already; at most {MOST_BYTES_OF_A_TICK} are allowed")
        step.bytes += len(payload)
        step.messages[place] = record
        if is_act(name):
            self.window.let_in(record)
        return ()

    def end(self, done: TickDone) -> Iterator[Record]:
        """Take a node's end of a tick; raises OrderError if it is not one that the node may end now."""
        name, node, what = done.node, self._nodes[done.node], f"end of tick {done.tick}"
        if done.tick < node.written:
            past = node.past_of(done.tick)
            if past is not None:
                past.ended_again = True
                said = replace(done, outcome=None) if self.rebuilt and past.end != done else done
                past.differs = past.differs or past.end not in (done, said)
            if done.last and self.rebuilt:
                self.outcome = done.outcome or self.outcome
            raise RepeatError(f"{what} again")
        self._check_open(name, node, done.tick)
        ends = node.open[done.tick].ends
        if done in ends:
            raise RepeatError(f"{what} again")
        if ends:
            self._doubt(what, name)
            self.split = self.split or any(one.last != done.last for one in ends)
        if len(ends) < _CLAIMS:
            ends.append(done)
            if done.last:
                self.over[name] = done.tick
        yield from self._write_complete(name, node)

    def entry(self, envelope: Envelope, entry: JournalEntry, payload: bytes) -> Iterator[Record]:
        """Take a journal entry; raises OrderError if it is not of a step that the node makes now."""
        name, node = envelope.node, self._nodes[envelope.node]
        record = Record(JOURNAL_PREFIX + name, envelope, payload, entry)
        if (record.topic, entry.step) in node.missing:
            node.missing.discard((record.topic, entry.step))
            yield record
            return
        if entry.step < node.written:
            self._entered_again(name, node, record)
        self._check_open(name, node, entry.step)
        entries = node.open[entry.step].entries
        if any(one.payload == payload for one in entries):
            raise RepeatError(f"entry of step {entry.step} again")
        if entries:
            self._doubt(f"entry of step {entry.step}", name)
        if len(entries) < _CLAIMS:
            entries.append(record)
        yield from self._write_complete(name, node)

    def forget_open(self) -> None:
        """Forget what has come of steps that are not written."""
        for node in self._nodes.values():
            node.open.clear()

    def kept(self) -> dict[str, int]:
        """Return of how many ticks of each node all is written, and in lockstep read by those who wait for it."""
        return {name: node.written if self._realtime else node.read(self.ticks) for name, node in self._nodes.items()}

    def entered(self, name: str) -> tuple[dict[int, Done], dict[str, int]]:
        """Return the steps of a node that is gone which follow the written ones, and the next numbers of its topics.

        In realtime an entry is all that it takes to do a step again, and to say again what has not come of it.
        """
        node = self._nodes[name]
        following = {}
        numbers = {topic: seen.following for topic, seen in node.seen.items()} | node.next
        for number in range(node.written, node.written + len(node.open)):
            step = node.open.get(number)
            if step is None or not step.entries:
                break
            following[number] = done = done_of(step.entries[0], step.messages.values())
            numbers |= {one.topic: one.sequence + 1 for one in done.journal.hosted}
            numbers |= {one.topic: one.sequence + 1 for one in done.journal.produced}
        return following, numbers

    def forget_lost(self, name: str) -> None:
        """Forget what has come of steps of a node that nobody can do again: its entry went first, and is not here."""
        node = self._nodes[name]
        following, _ = self.entered(name)
        for number in [number for number in node.open if number not in following]:
            del node.open[number]

    def rest(self) -> Iterator[Record]:
        """Yield what has come of steps that are not whole; nothing may follow."""
        for name, node in self._nodes.items():
            for step in sorted(node.open):
                yield from self._write(name, node, step, *first_of(node.open[step]))

    def lacking(self) -> dict[str, int]:
        """Return the nodes of whose run something is missing, and their last ticks."""
        steps = self._nodes
        return {name: last for name, last in self.over.items() if steps[name].missing or not steps[name].ended}

    def missing(self) -> dict[str, int]:
        """Return how many messages were promised and have not come, by topic."""
        return dict(Counter(topic for node in self._nodes.values() for topic, _ in node.missing))

    def _check_open(self, name: str, node: NodeSteps, step: int) -> None:
        """A node is in the step that is to be written, or in the next one if that has an end or an entry."""
        current, here = node.written, node.open.get(node.written)
        begun = here is not None and bool(here.ends or here.entries)
        if node.ended or (step != current and not (step == current + 1 and begun)):
            at = "its last step is over" if node.ended else f"expected {current}, the one that {name} is in"
            raise OrderError(f"tick {step}; {at}")

    def _note_early(self, node: NodeSteps, record: Record) -> None:
        """Remember a message that is refused here, and that a node may have taken: in realtime it knows of no ticks."""
        place = record.topic, record.envelope.sequence
        if self._realtime and len(node.early) < _EARLY and place[1] >= node.next[place[0]]:
            node.early.setdefault(place, digest_of(record.payload))

    def _check_claim(self, name: str, sender: str, held: Record, record: Record) -> None:
        """Raise OrderError unless a second message for a place replaces the first: what cannot be read is not true.

        The run is doubtful if both can be read, and differ.
        """
        what = f"message {record.envelope.sequence} on {name}"
        if held.payload == record.payload:
            raise RepeatError(f"{what} again")
        if not self._readable(record):
            raise OrderError(f"a second {what}, which cannot be read")
        if self._readable(held):
            raise OrderError(self._doubt(what, sender))
        self.dropped.append(Dropped(name, OrderError(f"the first {what}, which cannot be read")))

    def _readable(self, record: Record) -> bool:
        try:
            decode(record.topic, record.payload, self._roles.topics)
        except ProtocolError:
            return False
        return True

    def _doubt(self, what: str, name: str) -> str:
        """Doubt the run, because a second claim for a place in it differs from the first, and return a sentence."""
        text = f"two messages that differ claim to be the {what} of {name}"
        self.doubt = self.doubt or text
        return text

    def _again(self, node: NodeSteps, record: Record) -> NoReturn:
        """Raise OrderError for a message of a step that is written."""
        envelope = record.envelope
        past = node.past_of(envelope.tick)
        held = None if past is None else past.messages.get((record.topic, envelope.sequence))
        if past is not None and held is not None and held != digest_of(record.payload):
            past.differs = True
        raise RepeatError(f"sequence {envelope.sequence} of tick {envelope.tick}, which has ended")

    def _entered_again(self, name: str, node: NodeSteps, record: Record) -> NoReturn:
        """Raise OrderError for an entry of a step that is written.

        What a node sends comes in order: if a stranger was faster, then all of the true step comes again, its end and
        its entry too. A single message that differs comes from a stranger who was late.
        """
        step = record.envelope.sequence
        past = node.past_of(step)
        if past is not None and past.ended_again and (past.differs or past.entry != record.payload):
            self.doubt = self.doubt or f"step {step} of {name} has come twice, and differs"
            self.split = self.split or node.ended
        raise RepeatError(f"entry of step {step} again")

    def _write_complete(self, name: str, node: NodeSteps) -> Iterator[Record]:
        """Write the steps that are whole, and those whose rest is lost: then the next one is here."""
        while step := node.open.get(node.written):
            pairs = [(end, entry) for end in step.ends for entry in step.entries if self._agree(node, end, entry)]
            whole = [pair for pair in pairs if self._lacking(node, step, pair[0]) == 0]
            following = node.open.get(node.written + 1)
            if whole or (pairs and not self.patient):
                end, entry = (whole or pairs)[0]
                yield from self._write(name, node, node.written, end, entry)
            elif not self.patient and following is not None and following.ends and following.entries:
                if step.ends and step.entries:
                    self.doubt = self.doubt or f"end and entry of step {node.written} of {name} do not agree"
                yield from self._write(name, node, node.written, *first_of(step))
            else:
                return

    def _agree(self, node: NodeSteps, end: TickDone, record: Record) -> bool:
        """Return whether an entry has what the end of the tick promises of the topics that the node itself writes."""
        entry = record.entry
        assert entry is not None
        if (end.stamp_ns, end.last) != (entry.stamp_ns, entry.last):
            return False
        written = self._roles.written(end.node)
        expected = {name: count for name, count in self._counts(end).items() if name in written}
        made = [produced for produced in entry.produced if self._roles.promised(produced.topic, end.node)]
        if len(made) != sum(expected.values()):
            return False
        numbers: Counter[str] = Counter()  # how many of each topic so far
        for produced in made:
            if produced.sequence != node.next[produced.topic] + numbers[produced.topic]:
                return False
            numbers[produced.topic] += 1
        return dict(numbers) == expected

    def _counts(self, end: TickDone) -> dict[str, int]:
        """Return how many messages on each topic belong to the step."""
        return {name: count for name, count in end.counts.items() if self._roles.promised(name, end.node)}

    def _lacking(self, node: NodeSteps, step: OpenStep, end: TickDone) -> int:
        return sum(
            (name, node.next[name] + index) not in step.messages
            for name, count in self._counts(end).items()
            for index in range(count)
        )

    def _write(
        self, name: str, node: NodeSteps, number: int, end: TickDone | None, entry: Record | None
    ) -> Iterator[Record]:
        """Write a step, note what of it is missing, and go on to the next one."""
        step = node.open.pop(number)
        counts = counts_of(step) if end is None else self._counts(end)
        for topic, count in counts.items():
            first = node.next[topic]
            promised = ((topic, sequence) for sequence in range(first, first + count))
            node.missing.update(place for place in promised if place not in step.messages)
            node.next[topic] = first + count
        written: dict[PlaceInTopic, bytes] = {}
        belonging: list[Record] = []
        for place, record in step.messages.items():
            if 0 < node.next[place[0]] - place[1] <= counts.get(place[0], 0):
                written[place] = claim = digest_of(record.payload)
                if node.early.pop(place, claim) != claim:
                    self._doubt(f"message {place[1]} on {place[0]}", name)
                belonging.append(record)
                yield self._counted(record)
            else:
                self._note_early(node, record)
                text = f"sequence {place[1]}, which is not among those that {name} has sent in tick {number}"
                self.dropped.append(Dropped(place[0], OrderError(text)))
        if entry is not None:
            if end is not None and entry.entry is not None:
                self.doubt = self.doubt or self._consumption.wrote(name, end, entry.entry)
            yield entry
        else:
            node.missing.add((JOURNAL_PREFIX + name, number))
        self.window.wrote(end, belonging, entry)
        if end is not None:
            self.stamp_ns = max(self.stamp_ns, end.stamp_ns)
            node.ended = end.last
            self.outcome = end.outcome or self.outcome
            if end.last:
                self.over[name] = end.tick
            else:
                self.over.pop(name, None)
        node.past.append(PastStep(written, end, entry))
        node.written = number + 1
        self.written += 1
        self.ticks = min(other.written for other in self._nodes.values())

    def _counted(self, record: Record) -> Record:
        self.messages += 1
        return record
