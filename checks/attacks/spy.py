"""What a stranger hears on the bus, and messages that it makes of it."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import msgspec
from dynpf_protocol.control import Beat, Recorded, Stop, TickDone, decode_control, encode_control
from dynpf_protocol.envelope import Envelope, decode_envelope, encode_envelope
from dynpf_protocol.errors import ProtocolError
from dynpf_protocol.journal import JournalEntry, decode_entry, encode_entry
from dynpf_protocol.keys import ALIVE, BEAT, DATA, JOURNAL, RECORDED, STOP, TICK, data_key, topic_of
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.machines.events import Arrived

__all__ = ["SOURCE", "Spy"]

SOURCE = "simulator"
_KEPT = 3000


class Spy:
    """All that a stranger can know: who is there, under which boots, and what they have said last."""

    def __init__(self) -> None:
        self.boots: dict[str, str] = {}
        self.ends: dict[str, TickDone] = {}
        self.entries: dict[str, tuple[Envelope, JournalEntry]] = {}
        self.messages: dict[str, tuple[Envelope, bytes]] = {}
        self.first: dict[str, bytes] = {}  # topic -> the first payload heard, which fits the topic and is out of date
        self.heard: deque[Arrived] = deque(maxlen=_KEPT)

    @property
    def ticks(self) -> int:
        """How many ticks the source has ended."""
        return self.ends[SOURCE].tick + 1 if SOURCE in self.ends else 0

    def token(self, key: str) -> None:
        """Note a liveliness token."""
        if key.startswith(ALIVE):
            name, _, boot = key[len(ALIVE) :].rpartition("/")
            self.boots.setdefault(name, boot)

    def hear(self, arrived: Arrived) -> None:
        """Note a message."""
        self.heard.append(arrived)
        try:
            self._note(arrived)
        except (ProtocolError, msgspec.DecodeError):
            return  # another stranger's

    def _note(self, arrived: Arrived) -> None:
        key = arrived.key
        if key.startswith(TICK):
            done = decode_control(arrived.payload, TickDone)
            self.ends[done.node] = done
            self.boots[done.node] = done.boot
        elif key.startswith(JOURNAL):
            envelope = decode_envelope(arrived.attachment)
            self.entries[envelope.node] = envelope, decode_entry(arrived.payload)
        elif key.startswith(DATA):
            envelope = decode_envelope(arrived.attachment)
            topic, _ = topic_of(key)
            self.messages[topic] = envelope, arrived.payload
            self.first.setdefault(topic, arrived.payload)

    def boot(self, name: str) -> str:
        """Return the boot of a process, or one that is wrong if it is not known."""
        return self.boots.get(name, "unknown")

    def data(
        self, topic: str, /, *, payload: bytes | None = None, ahead: int = 1, ticks: int = 1, **changes: Any
    ) -> Put:
        """Return a message like the last one on ``topic``, ``ahead`` sequences and ``ticks`` ticks later."""
        last, _ = self.messages[topic]
        tick_ns = 0 if last.tick == 0 else last.stamp_ns // last.tick
        changed = msgspec.structs.replace(
            last, sequence=last.sequence + ahead, tick=last.tick + ticks, stamp_ns=(last.tick + ticks) * tick_ns
        )
        envelope = msgspec.structs.replace(changed, **changes)
        key = data_key(topic, envelope.node)
        return Put(key, self.first[topic] if payload is None else payload, encode_envelope(envelope))

    def end(self, node: str, /, *, ticks: int = 1, key: str = "", **changes: Any) -> Put:
        """Return the end of a tick like the last one of ``node``, ``ticks`` ticks later."""
        last = self.ends[node]
        tick = last.tick + ticks
        tick_ns = 0 if last.tick == 0 else last.stamp_ns // last.tick
        later = msgspec.structs.replace(last, step=tick, tick=tick, stamp_ns=tick * tick_ns)
        return Put(TICK + (key or node), encode_control(msgspec.structs.replace(later, **changes)))

    def entry(self, node: str, /, *, steps: int = 1, key: str = "", of: Mapping[str, Any] = {}, **changes: Any) -> Put:
        """Return a journal entry like the last one of ``node``, ``steps`` later; ``of`` changes its envelope."""
        envelope, last = self.entries[node]
        step = last.step + steps
        tick_ns = 0 if last.tick == 0 else last.stamp_ns // last.tick
        place = {"tick": step, "stamp_ns": step * tick_ns}
        entry = msgspec.structs.replace(msgspec.structs.replace(last, step=step, **place), **changes)
        later = msgspec.structs.replace(msgspec.structs.replace(envelope, sequence=step, **place), **of)
        return Put(JOURNAL + (key or node), encode_entry(entry), encode_envelope(later))

    def stop(self, name: str, boot: str = "", reason: str = "enough") -> Put:
        """Return a request to stop in the name of a process."""
        return Put(STOP + name, encode_control(Stop(name, boot or self.boot(name), reason)))

    def recorded(self, complete: bool, boot: str = "", reason: str = "a stranger says so") -> Put:
        """Return the recorder's word that the recording is closed."""
        return Put(RECORDED, encode_control(Recorded(boot or self.boot("recorder"), complete, reason, "x.mcap")))

    def beat(self, name: str, ticks: int, boot: str = "") -> Put:
        """Return a heartbeat in the name of a process."""
        return Put(BEAT + name, encode_control(Beat(name, boot or self.boot(name), ticks)))
