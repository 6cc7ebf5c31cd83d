"""Bugs as people make them, to be put into the machines on purpose: the simulator has to find each."""

from collections.abc import Callable, Iterator

import pytest
from dynpf_formats.recording.header import RunEnd
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import OrderError
from dynpf_runtime.executor import Executor
from dynpf_runtime.machines.effects import Effect, Put, Record
from dynpf_runtime.machines.events import Arrived, Now
from dynpf_runtime.machines.intake import Intake, Refusal
from dynpf_runtime.machines.ledger import Ledger
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.machines.unconfirmed import Unconfirmed
from dynpf_runtime.machines.window import Part, Window

__all__ = ["BUGS", "wrong_bound"]


def lost_confirmation(patch: pytest.MonkeyPatch) -> None:
    """A recorder that has taken over from another does not say that the recording is closed."""
    confirm = RecorderMachine._confirm

    def silent(self: RecorderMachine, end: RunEnd, now: Now) -> Iterator[Effect]:
        effects = list(confirm(self, end, now))
        if self._member.successor:
            self._last_word.put = Put("nobody/hears/it", b"")  # type: ignore[union-attr]
            effects = [effect for effect in effects if type(effect) is not Put]
        yield from effects

    patch.setattr(RecorderMachine, "_confirm", silent)


def off_by_one(patch: pytest.MonkeyPatch) -> None:
    """A node's new start gives its next messages numbers that are one too high."""
    number_from = Executor.number_from
    patch.setattr(Executor, "number_from", lambda self, topic, sequence: number_from(self, topic, sequence + 1))


def appended_twice(patch: pytest.MonkeyPatch) -> None:
    """The recorder writes a message that has come before, of the step that it writes or of an earlier one."""
    message = Ledger.message

    def twice(self: Ledger, name: str, sender: str, envelope: Envelope, payload: bytes) -> tuple[Record, ...]:
        try:
            return message(self, name, sender, envelope, payload)
        except OrderError:
            return (Record(name, envelope, payload),)

    patch.setattr(Ledger, "message", twice)


def swallowed_duplicate(patch: pytest.MonkeyPatch) -> None:
    """A node that hears a message again throws away the first one, too."""
    take = Intake.take

    def swallow(self: Intake, arrival: Arrived, now_ns: int) -> Refusal | None:
        refusal = take(self, arrival, now_ns)
        if refusal is not None and isinstance(refusal.error, OrderError) and "again" in str(refusal.error):
            self._inbox._messages.clear()  # type: ignore[attr-defined]
        return refusal

    patch.setattr(Intake, "take", swallow)


def forgotten_timer(patch: pytest.MonkeyPatch) -> None:
    """A node forgets to say again what somebody who was gone may have missed."""
    patch.setattr(Unconfirmed, "rouse", lambda *_: None)


def wrong_bound(patch: pytest.MonkeyPatch) -> None:
    """Who goes on from a snapshot is not told what was said in the snapshot's tick, which the next one may read."""
    part = Window.part

    def later(self: Window, name: str, tick: int) -> Part:
        found = part(self, name, tick)
        return found._replace(next_tick=found.next_tick + 1) if found.snapshot else found

    patch.setattr(Window, "part", later)


BUGS: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "a lost confirmation": lost_confirmation,
    "an off-by-one in the successor's sequence": off_by_one,
    "a recorder that appends twice": appended_twice,
    "a swallowed duplicate": swallowed_duplicate,
    "a forgotten timer": forgotten_timer,
}
