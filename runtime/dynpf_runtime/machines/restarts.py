"""Restarts: which processes were gone in mid-run and have been started again, as the recorder notes it."""

from collections.abc import Iterator, Mapping

from dynpf_protocol.keys import ROUTER
from dynpf_protocol.messages import Restart

from dynpf_runtime.machines.events import Token
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.roster import boot_of, holder

__all__ = ["Restarts"]

_SECOND_NS = 10**9


class Restarts:
    """What the recorder, a ``member`` of the run, sees of processes that go and come back."""

    def __init__(self, member: Membership) -> None:
        self.began_ns = 0  # since when the recorder is there
        self._member = member
        self._known: dict[str, str] = {}  # a node -> the last start that is told of
        self._gone: dict[str, tuple[int, int]] = {}  # a node -> ticks recorded when it was gone, and when
        self._router: tuple[str, int, int] | None = None  # the start that is gone, ticks, and when

    def gone_ns(self, name: str) -> int:
        """Return since when the start of a node is gone from which another takes over, as far as has been seen."""
        return self._gone[name][1] if name in self._gone else self.began_ns

    def take(self, token: Token, now_ns: int) -> Restart | None:
        """Note a token that ``member`` has taken; return what to record when a process has caught up with another."""
        name, start, ready = holder(token)
        if name == ROUTER:
            return self._take_router(start, now_ns, present=token.present)
        if name not in self._member.peers or self._member.starts.get(name) != start:
            return None
        if not token.present:
            self._gone.setdefault(name, (self._member.ticks, now_ns))
        elif start == self._before(name, start):
            self._gone.pop(name, None)  # it was cut off
        elif ready:
            return self._back(name, start, now_ns)
        return None

    def lose_all(self, now_ns: int) -> None:
        """Note that all nodes are gone: the run is resumed."""
        for name, start in self._member.starts.items():
            self._known[name], self._gone[name] = start, (self._member.ticks, now_ns)

    def missed(self, told: Mapping[str, str], now_ns: int) -> Iterator[Restart]:
        """Yield who has come back while no recorder was there; the one before has ``told`` of these starts."""
        self._known.update(told)
        starts = self._member.starts
        for name in sorted(self._member.ready & starts.keys()):
            if self._before(name, starts[name]) != starts[name]:
                yield self._back(name, starts[name], now_ns)

    def _before(self, name: str, start: str) -> str:
        """Return the start of a node that is told of: the first one if nothing else is known."""
        return self._known.setdefault(name, boot_of(start))

    def _take_router(self, start: str, now_ns: int, *, present: bool) -> Restart | None:
        """The router takes nothing over: each of its starts has a name of its own."""
        if not present:
            self._router = start, self._member.ticks, now_ns
        elif self._router is not None and self._router[0] != start:
            (before, tick, gone_ns), self._router = self._router, None
            return Restart(node=ROUTER, before=before, start=start, tick=tick, absent_s=(now_ns - gone_ns) / _SECOND_NS)
        return None

    def _back(self, name: str, start: str, now_ns: int) -> Restart:
        before, self._known[name] = self._before(name, start), start
        tick, gone_ns = self._gone.pop(name, (self._member.ticks, self.began_ns))
        return Restart(node=name, before=before, start=start, tick=tick, absent_s=(now_ns - gone_ns) / _SECOND_NS)
