"""Bugs as people make them, to be put into the machines on purpose: the simulator has to find each."""

from collections.abc import Callable

import pytest
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import OrderError
from dynpf_runtime.machines import membership, node_host, router
from dynpf_runtime.machines.effects import NEVER_NS, Record
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.intake import Intake, Refusal
from dynpf_runtime.machines.ledger import Ledger

__all__ = ["BUGS"]


def lost_confirmation(patch: pytest.MonkeyPatch) -> None:
    """Nobody waits for the recorder's last word once its token is gone: the two come on ways of their own."""
    patch.setattr(membership, "LAST_WORD_NS", 0)
    patch.setattr(router, "LAST_WORD_NS", 0)


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
    """A node that has made its last step waits for ever for a recorder that hangs."""
    patch.setattr(node_host, "RECORDED_NS", NEVER_NS // 2)


BUGS: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "a lost confirmation": lost_confirmation,
    "a recorder that appends twice": appended_twice,
    "a swallowed duplicate": swallowed_duplicate,
    "a forgotten timer": forgotten_timer,
}
