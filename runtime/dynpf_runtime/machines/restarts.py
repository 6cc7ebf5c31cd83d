"""Restarts: which processes were gone in mid-run and have been started again, as the recorder notes it."""

from collections.abc import Iterator, Mapping

from dynpf_protocol.keys import ROUTER
from dynpf_protocol.messages import Restart

from dynpf_runtime.machines.events import Token
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.roster import follows, holder

__all__ = ["Restarts"]

_SECOND_NS = 10**9


class Restarts:
    """What the recorder, a ``member`` of the run, sees of processes that go and come back."""

    def __init__(self, member: Membership) -> None:
        self.began_ns = 0  # since when the recorder is there
        self._member = member
        self._gone: dict[str, tuple[str, int, int]] = {}  # a process -> its start, ticks recorded, and when

    def gone_ns(self, name: str) -> int:
        """Return since when the start of a process is gone from which another takes over, as far as has been seen."""
        return self._gone[name][2] if name in self._gone else self.began_ns

    def take(self, token: Token, now_ns: int) -> Restart | None:
        """Note a token that ``member`` has taken; return what to record when a process has caught up with another."""
        name, start, ready = holder(token)
        if name == ROUTER:
            return self._router(start, now_ns, present=token.present)
        if name not in self._member.peers or self._member.starts.get(name) != start:
            return None
        if not token.present:
            self._gone.setdefault(name, (start, self._member.ticks, now_ns))
        elif name in self._gone and start == self._gone[name][0]:
            del self._gone[name]  # it was cut off
        elif ready and name in self._gone and follows(start, self._gone[name][0]):
            return self._back(name, start, now_ns)
        return None

    def lose_all(self, now_ns: int) -> None:
        """Note that all nodes are gone: the run is resumed."""
        for name, start in self._member.starts.items():
            self._gone[name] = start, self._member.ticks, now_ns

    def missed(self, told: Mapping[str, str], now_ns: int) -> Iterator[Restart]:
        """Yield who has come back while no recorder was there: another had ``told`` of these starts.

        Who is gone may still come back.
        """
        member = self._member
        for name, start in told.items():
            if name in member.present and member.starts[name] == start:
                continue
            self._gone[name] = start, member.ticks, self.began_ns
            if name in member.ready and follows(member.starts[name], start):
                yield self._back(name, member.starts[name], now_ns)

    def _router(self, start: str, now_ns: int, *, present: bool) -> Restart | None:
        """The router takes nothing over: each of its starts has a name of its own."""
        if not present:
            self._gone[ROUTER] = start, self._member.ticks, now_ns
        elif ROUTER in self._gone and self._gone[ROUTER][0] != start:
            return self._back(ROUTER, start, now_ns)
        return None

    def _back(self, name: str, start: str, now_ns: int) -> Restart:
        before, tick, gone_ns = self._gone.pop(name)
        return Restart(node=name, before=before, start=start, tick=tick, absent_s=(now_ns - gone_ns) / _SECOND_NS)
