"""Deafness: a node that does not hear what it waits for, though it was sent, says so."""

from collections.abc import Iterator

from dynpf_protocol.keys import RECORDER

from dynpf_runtime.machines.effects import Tell
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.plan import Plan

__all__ = ["AHEAD", "Deafness"]

AHEAD = 1000
"""How many ticks the source may run ahead of the recorder."""

DEAF_NS = 3_000_000_000
"""How long a step may stay away after all that it waits for has been sent; then a notice says so."""


class Deafness:
    """What the node ``name`` of a run of ``plan``, a ``member`` of it, does not hear."""

    def __init__(self, name: str, plan: Plan, member: Membership) -> None:
        self._name, self._plan, self._member = name, plan, member
        self._noticed = -1  # the tick of which the notice was given

    def notice(self, leads: bool, paced: bool, stepped_ns: int, now_ns: int) -> Iterator[Tell]:
        """Tell if a tick does not begin though, by their heartbeats, all nodes that it waits for have ended theirs.

        The node has made its last step at ``stepped_ns``; it ``leads`` if it is the run's source, which is ``paced`` if
        its ticks have times.
        """
        tick, plan = self._member.ticks, self._plan
        paced = leads and (paced or tick - self._member.behind(RECORDER) > AHEAD)
        if plan.clock != "lockstep" or paced or now_ns < stepped_ns + DEAF_NS:
            return
        awaited = {node: tick - lag for node, lag in plan.graph.lags[self._name].items() if tick >= lag}
        if awaited and tick != self._noticed and all(self._member.behind(node) > awaited[node] for node in awaited):
            self._noticed = tick
            yield Tell(
                f"tick {tick} does not begin, though {', '.join(awaited)} sent all that it waits for: it was lost, or "
                f"{self._name}'s key may not hear it"
            )
