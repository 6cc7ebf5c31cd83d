"""Absence: which peers of a process are gone, since when, and how long they are waited for."""

from collections.abc import Callable, Iterator

from dynpf_protocol.errors import BrokenOffError
from dynpf_protocol.keys import RECORDER

from dynpf_runtime.machines.effects import NEVER_NS, Tell

__all__ = ["LAST_WORD_NS", "SURE_NS", "Absence"]

SURE_NS = 50_000_000
"""How long to wait after a peer's token disappears: if the router is gone, the peers' tokens disappear first."""

LAST_WORD_NS = 500_000_000
"""Tokens and messages come on ways of their own: the recorder's last word may come after its token has gone."""

_SECOND_NS = 10**9
_ROUTER_GONE = "the router is gone or hangs; the run cannot go on"


class Absence:
    """Who is gone. A peer, or the router, that does not come back within ``patience_ns`` breaks the run off.

    ``tells`` says of whom this process tells that it is waited for: one telling is enough.
    """

    def __init__(self, patience_ns: int, tells: Callable[[str], bool]) -> None:
        self.patience_ns = patience_ns
        self.returns = 0  # how often someone has come back
        self.resumed = False  # whether this process takes over from another start
        self.cut = False  # whether the router is gone
        self.was_cut = False
        self.closed_early = ""  # why the recorder has closed the recording before the run was over
        self._gone_ns: dict[str, int] = {}
        self._cut_ns = 0
        self._told: set[str] = set()
        self._tells = tells

    @property
    def missing(self) -> bool:
        """Whether somebody is waited for."""
        return self.cut or bool(self._gone_ns)

    @property
    def disturbed(self) -> bool:
        """Whether anybody has been gone so far: what was said before may be said again."""
        return self.resumed or self.returns > 0 or self.missing

    def left(self, peer: str, now_ns: int) -> None:
        """Note that a peer's token is gone."""
        self._gone_ns.setdefault(peer, now_ns)

    def back(self, peer: str) -> None:
        """Note that a peer has come back, and so the router, if it was gone."""
        self._gone_ns.pop(peer, None)
        self._told.discard(peer)
        self.returns += 1

    def lose_router(self, now_ns: int) -> None:
        """Note that the router is gone; raises BrokenOffError if nobody waits for it."""
        if not self.cut:
            self.cut = self.was_cut = True
            self._cut_ns = now_ns
        if now_ns - self._cut_ns >= self.patience_ns:
            raise BrokenOffError(_ROUTER_GONE)

    def find_router(self) -> None:
        """Note that something has come from the router."""
        if self.cut:
            self.cut = False
            self._told.clear()

    def stop_waiting(self) -> None:
        """Wait for nobody any more; raises BrokenOffError if the router is gone."""
        self.patience_ns = 0
        if self.cut:
            raise BrokenOffError(_ROUTER_GONE)

    def due_ns(self) -> int:
        """Return when ``judge`` is to be called next."""
        return min((self._due_ns(peer, since_ns) for peer, since_ns in self._gone_ns.items()), default=NEVER_NS)

    def judge(self, now_ns: int, ticks: int, may_go: Callable[[str], bool]) -> Iterator[Tell]:
        """Tell who is waited for; raises BrokenOffError for one that has not come back in time.

        Nobody waits for a peer that ``may_go``. This process has ended ``ticks`` ticks.
        """
        for peer, since_ns in list(self._gone_ns.items()):
            if now_ns < since_ns + _sure_ns(peer):
                continue
            if peer == RECORDER and self.closed_early:
                raise BrokenOffError(f"the recorder has closed the recording: {self.closed_early}")
            if may_go(peer):
                del self._gone_ns[peer]
                continue
            gone = f"{peer} is gone (killed, crashed, stopped or cut off) after tick {ticks}"
            if now_ns >= since_ns + _sure_ns(peer) + self.patience_ns:
                raise BrokenOffError(f"{gone}; the run cannot go on")
            if peer not in self._told:
                self._told.add(peer)
                if self._tells(peer) and not self.cut:
                    yield Tell(f"{gone}; the run waits {self.patience_ns // _SECOND_NS} s for it to be started again")

    def _due_ns(self, peer: str, since_ns: int) -> int:
        sure_ns = since_ns + _sure_ns(peer)
        return sure_ns if peer not in self._told else sure_ns + self.patience_ns


def _sure_ns(peer: str) -> int:
    return LAST_WORD_NS if peer == RECORDER else SURE_NS
