"""Intake: checks messages from the bus before a node gets them.

A bad message is refused and counted, and told of at a bounded rate; the process continues.
"""

from collections import Counter
from typing import NamedTuple, Protocol

from dynpf_protocol.codec import decode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import ProtocolError, TooLargeError
from dynpf_protocol.keys import TICK

from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.roles import MOST_BYTES_OF_A_TICK, Roles
from dynpf_runtime.node import Received

__all__ = ["Inbox", "Intake", "Refusal"]


class Inbox(Protocol):
    """What an intake asks of an inbox, and gives to it."""

    tick: int
    """How many steps the node has made."""

    def admit(self, name: str, sender: str, envelope: Envelope) -> None:
        """Raise OrderError for a message that is not its sender's next."""

    def admit_end(self, done: TickDone) -> None:
        """Raise OrderError for the end of a tick that is not its node's next."""

    def deliver(self, received: Received, tick: int, now_ns: int) -> None:
        """Add a message of a tick."""

    def deliver_refused(self, name: str, sender: str, envelope: Envelope) -> None:
        """Note a message whose content was refused."""

    def done(self, done: TickDone) -> None:
        """Note that an upstream node has ended a tick."""


class Refusal(NamedTuple):
    """The key of a message that was not accepted, and why."""

    key: str
    error: ProtocolError


class Intake:
    """Puts arrivals into a node's inbox if their senders may say that, and now; else refuses them."""

    def __init__(self, roles: Roles, inbox: Inbox) -> None:
        self._roles = roles
        self._inbox = inbox
        self._tick = 0
        self._taken: Counter[str] = Counter()  # sender -> bytes since the node's last step

    def take(self, arrival: Arrived, now_ns: int) -> Refusal | None:
        """Take a message, or the word that a node has ended a tick; return why it was refused, or None."""
        key = arrival.key
        try:
            if key.startswith(TICK):
                done = self._roles.tick(arrival)
                self._inbox.admit_end(done)
                self._inbox.done(done)
            else:
                name, sender, envelope = self._roles.message(arrival)
                self._inbox.admit(name, sender, envelope)
                self._weigh(sender, len(arrival.payload))
                self._deliver(name, sender, envelope, arrival.payload, now_ns)
        except ProtocolError as error:
            return Refusal(key, error)
        return None

    def _weigh(self, sender: str, size: int) -> None:
        """Raise TooLargeError for what would be too much to hold until the node's next step."""
        if self._inbox.tick != self._tick:
            self._tick = self._inbox.tick
            self._taken.clear()
        taken = self._taken[sender] + size
        if taken > MOST_BYTES_OF_A_TICK:
            raise TooLargeError(
                f"{sender} has sent {taken} bytes; at most {MOST_BYTES_OF_A_TICK} are allowed in a tick"
            )
        self._taken[sender] = taken

    def _deliver(self, name: str, sender: str, envelope: Envelope, payload: bytes, now_ns: int) -> None:
        try:
            message = decode(name, payload, self._roles.topics)
        except ProtocolError:
            self._inbox.deliver_refused(name, sender, envelope)
            raise
        node, boot, sequence, stamp_ns = envelope.node, envelope.boot, envelope.sequence, envelope.stamp_ns
        self._inbox.deliver(Received(name, node, boot, sequence, stamp_ns, message), envelope.tick, now_ns)
