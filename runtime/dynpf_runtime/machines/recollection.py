"""Recollection: how a node's new start gets from the recorder what its predecessor has read and done."""

from dynpf_protocol.control import TickDone, decode_control
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.errors import OrderError, ProtocolError, RunError, UnknownSenderError
from dynpf_protocol.journal import JournalEntry, encode_entry
from dynpf_protocol.keys import RECALL, RECALLED, RECORDER, TICK
from dynpf_protocol.recall import Recall, Recalled, decode_recalled, encode_recall

from dynpf_runtime.machines.effects import NEVER_NS, Put
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.roles import check_boot
from dynpf_runtime.machines.window import entry_digest

__all__ = ["Recollection"]

_AGAIN_NS = 200_000_000
"""How long to wait for an answer before asking again."""

_MOST_WAITING = 48 * 2**20
"""How much may wait that comes from others in the meantime, bytes; they say it again."""


class Recollection:
    """What ``member`` recalls. It has been ``written`` steps, of which it makes no message known again.

    Of ``said`` steps the predecessor has said that they have ended, and that ``last`` was its last one.
    """

    def __init__(self, member: Membership) -> None:
        self.written = 0
        self.said = 0
        self.last: int | None = None
        self.wake_ns = NEVER_NS
        self._waiting: dict[int, list[Arrived]] = {}  # by tick
        self._member = member
        self._tick = 0
        self._entries: dict[int, bytes] = {}
        self._bytes = 0

    def ask(self, now_ns: int) -> Put:
        """Ask for what comes next."""
        self.wake_ns = now_ns + _AGAIN_NS
        name, start = self._member.name, self._member.start
        return Put(RECALL + name, encode_recall(Recall(name, start, self._tick)))

    def answered(self, arrived: Arrived) -> Recalled | None:
        """Return the recorder's answer, or None for one to an earlier question.

        Raises ProtocolError for what is no answer, RunError if the recorder no longer has all of the run.
        """
        recalled = decode_recalled(arrived.payload)
        check_boot(RECORDER, recalled.start, self._member.starts)
        if recalled.to != self._member.start:
            raise UnknownSenderError(f"it is for the start {recalled.to!r} of {arrived.key[len(RECALLED) :]}")
        if recalled.tick != self._tick:
            return None
        if recalled.next_tick < self._tick or (recalled.more and recalled.next_tick == self._tick):
            raise OrderError(f"the recorder goes from tick {self._tick} to {recalled.next_tick}")
        self._entries.update(enumerate(recalled.entries, self._tick))
        self._tick = recalled.next_tick
        if recalled.snapshot:
            self._entries.clear()
        if recalled.lacking:
            raise RunError(f"{self._member.name} cannot come back: {recalled.lacking}")
        self.written, self.said, self.last = recalled.written, recalled.said, recalled.last
        return recalled

    def expect(self, step: int, entry: bytes) -> None:
        """Note the journal entry that the predecessor has made of a step."""
        self._entries[step] = entry_digest(entry)

    def check(self, entry: JournalEntry) -> None:
        """Raise RunError for a step that is not as the predecessor's was."""
        digest = self._entries.pop(entry.step, None)
        if digest is not None and digest != entry_digest(encode_entry(entry)):
            raise RunError(
                f"{self._member.name} cannot go on: its step {entry.step} is not what it was before; a node's steps "
                "must follow from its parameters and inputs alone"
            )

    def put_off(self, arrived: Arrived) -> None:
        """Keep a message of another that is ahead of this process; they say it again if it is lost."""
        try:
            key, payload = arrived.key, arrived.payload
            tick = (
                decode_control(payload, TickDone).tick
                if key.startswith(TICK)
                else decode_envelope(arrived.attachment).tick
            )
        except ProtocolError:
            return
        self._bytes += len(arrived.payload)
        if self._bytes <= _MOST_WAITING:
            self._waiting.setdefault(tick, []).append(arrived)

    @property
    def waiting(self) -> bool:
        """Whether messages of others wait."""
        return bool(self._waiting)

    def due(self, tick: int) -> list[Arrived]:
        """Return the messages that waited until this process was in ``tick``."""
        ticks = sorted(waiting for waiting in self._waiting if waiting <= tick)
        found = [arrived for waiting in ticks for arrived in self._waiting.pop(waiting)]
        self._bytes -= sum(len(arrived.payload) for arrived in found)
        return found
