"""Heartbeats: what the peers of a process said last of their main loops, and who of them hangs."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from dynpf_protocol.control import Beat, Doing
from dynpf_protocol.errors import BrokenOffError

__all__ = ["BEAT_NS", "SILENT_NS", "STEP_NS", "WEDGED_NS", "Heard", "Heartbeats"]

BEAT_NS = 500_000_000

WEDGED_NS = 2_500_000_000
"""How long a main loop, which goes round twice a second, may stand still outside of steps, files and the bus."""

SILENT_NS = 15_000_000_000
"""How long a peer may say nothing and be connected: a library that it calls may keep its other threads from running."""

STEP_NS = 600_000_000_000
"""How long a step, or the disk, may take. A step that never ends cannot be told from a long one before."""

NOTICE_NS = 5_000_000_000
"""After this, and then ever twice as long, a notice says that a peer is silent or in a step."""

HELD_UP_NS = 1_000_000_000
"""A process that was itself held up for so long beyond its own heartbeat gives its peers their time anew."""

SECOND_NS = 1_000_000_000


class Heard(NamedTuple):
    """A heartbeat, and when it was heard."""

    beat: Beat
    at_ns: int


class Heartbeats:
    """The last heartbeat of each peer."""

    def __init__(self) -> None:
        self._heard: dict[str, Heard] = {}
        self._told_ns: dict[str, int] = {}  # how long a peer had been silent or in a step when it was last told
        self._looked_ns: int | None = None

    def take(self, beat: Beat, now_ns: int) -> None:
        """Note a heartbeat of a peer, whose boot has been checked."""
        self._heard[beat.node] = Heard(beat, now_ns)

    def heard(self, peer: str) -> Heard | None:
        """Return the last heartbeat of ``peer``."""
        return self._heard.get(peer)

    def ticks(self, peer: str) -> int:
        """Return how many ticks ``peer`` had ended at its last heartbeat."""
        heard = self._heard.get(peer)
        return 0 if heard is None else heard.beat.ticks

    def kept(self, recorder: str, node: str) -> int:
        """Return how many ticks of ``node`` the recorder had in its file at its last heartbeat."""
        heard = self._heard.get(recorder)
        return 0 if heard is None else heard.beat.kept.get(node, 0)

    def look(self, starts: Mapping[str, str], now_ns: int, patience_ns: int = 0) -> Iterator[str]:
        """Yield notices on present peers, by their ``starts``; raises BrokenOffError that names one that hangs.

        Whoever watches its process has ``patience_ns`` to start it again. To be called at every heartbeat of this
        process.
        """
        before_ns, self._looked_ns = self._looked_ns, now_ns
        if before_ns is not None and now_ns - before_ns > BEAT_NS + HELD_UP_NS:
            self._heard = {peer: heard._replace(at_ns=now_ns) for peer, heard in self._heard.items()}
            return
        for peer, (beat, at_ns) in self._heard.items():
            if starts.get(peer) == beat.boot:
                yield from self._judge(peer, beat, now_ns - at_ns, patience_ns)

    def _judge(self, peer: str, beat: Beat, silent_ns: int, patience_ns: int) -> Iterator[str]:
        if beat.doing is Doing.TURNING and beat.for_ns > WEDGED_NS + patience_ns:
            raise _hangs(peer, f"its main loop has stood still for {beat.for_ns / SECOND_NS:.1f} s")
        if silent_ns > SILENT_NS + patience_ns:
            raise _hangs(peer, f"it has said nothing for {silent_ns // SECOND_NS} s")
        lasted_ns = silent_ns
        what = "said nothing"
        if beat.doing in (Doing.STEP, Doing.FILE):
            lasted_ns = beat.for_ns + silent_ns
            what = f"been in the step of tick {beat.ticks}" if beat.doing is Doing.STEP else "waited for its disk"
        if lasted_ns > STEP_NS:
            raise _hangs(peer, f"it has {what} for {lasted_ns // SECOND_NS} s")
        if lasted_ns < NOTICE_NS:
            self._told_ns.pop(peer, None)
        elif lasted_ns >= 2 * self._told_ns.get(peer, 0):
            self._told_ns[peer] = lasted_ns
            yield f"{peer} has {what} for {lasted_ns // SECOND_NS} s"


def _hangs(peer: str, how: str) -> BrokenOffError:
    return BrokenOffError(f"{peer} hangs: {how}; the run cannot go on")
