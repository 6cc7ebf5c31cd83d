"""The recorder's last word: how the recording has ended, said until the others have left."""

from collections.abc import Iterator

from dynpf_protocol.control import Recorded, encode_control
from dynpf_protocol.keys import RECORDED, ROUTER

from dynpf_runtime.machines.effects import NEVER_NS, Put
from dynpf_runtime.machines.events import Event, StopAsked, Woke
from dynpf_runtime.machines.membership import Membership

__all__ = ["LastWord"]

SAY_AGAIN_NS = 250_000_000
"""How often it is repeated."""

SEE_OFF_NS = 2_000_000_000
"""How long the others may take to leave after it."""


class LastWord:
    """The word ``recorded`` of the recorder ``member``, said at ``now_ns``.

    The others, or this process, may be cut off at that moment: in a run that recovers it is said again. Who ``waits``
    has found a whole recording, and gives the others time to be seen.
    """

    def __init__(self, recorded: Recorded, member: Membership, now_ns: int, *, waits: bool) -> None:
        self.put = Put(RECORDED, encode_control(recorded))
        self.over = False
        self._member = member
        self._waits = waits
        self._due_ns = now_ns + SEE_OFF_NS
        self._heard_by_ns = now_ns + max(SEE_OFF_NS, member.absence.patience_ns if recorded.complete else 0)
        self._again_ns = now_ns + SAY_AGAIN_NS if member.recovers else NEVER_NS
        self._cut = False  # whether the router has been gone since then

    @property
    def wake_ns(self) -> int:
        """The time at which Woke is due."""
        return min(self._due_ns, self._again_ns)

    def again(self, event: Event, now_ns: int) -> Iterator[Put]:
        """Say it again if it is time, or find that it is ``over``: the others have left, or do not leave."""
        if type(event) is StopAsked:
            self._heard_by_ns = now_ns
        if ROUTER not in self._member.others.present:  # who has gone with it has not left, and will be back
            self._cut, self._due_ns = True, min(self._heard_by_ns, now_ns + SEE_OFF_NS)
        waits = self._cut or (self._waits and now_ns < self._again_ns)
        left = not (self._member.present or waits)
        if (left and type(event) is Woke) or now_ns >= self._due_ns:
            self.over = True
        elif left:
            self._again_ns = now_ns  # as soon as no arrival waits, such as the end of the router's token
        elif now_ns >= self._again_ns:
            self._again_ns = now_ns + SAY_AGAIN_NS
            yield self.put
