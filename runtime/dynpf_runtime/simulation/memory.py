"""The memory of nodes: what a node did on the same inputs in another trial it does again, without being executed.

A node is a function of what it has been given since its start. So the results of a step are known by a digest over all
of that, exactly; only a node that is given something new is executed, on all that it was given before as well.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from dynpf_runtime.graph import Graph
from dynpf_runtime.node import Node, Result, State, Step, encode_state
from dynpf_runtime.plan import Plan

__all__ = ["Memory", "remembering"]

_MOST = 20_000
"""How many steps are remembered."""

_ENCODER = msgspec.msgpack.Encoder()


class _Known(NamedTuple):
    """The results of a step, and a way to the state after it."""

    result: Result
    state: list[State]  # empty until somebody has asked for it


class Memory:
    """The results of steps, by digests of all that the nodes had been given; the latest ones are kept."""

    def __init__(self) -> None:
        self.hits = 0
        self.misses = 0
        self._known: OrderedDict[bytes, _Known] = OrderedDict()

    def get(self, key: bytes) -> _Known | None:
        """Return what is known of a step."""
        known = self._known.get(key)
        if known is None:
            self.misses += 1
            return None
        self.hits += 1
        return known

    def put(self, key: bytes, result: Result) -> _Known:
        """Remember a step."""
        known = self._known[key] = _Known(result, [])
        if len(self._known) > _MOST:
            self._known.popitem(last=False)
        return known


def remembering(plan: Plan, memory: Memory) -> Plan:
    """Return a plan whose nodes are those of ``plan`` and share a memory."""
    specs = [spec._replace(build=_builder(name, spec.build, memory)) for name, spec in plan.graph.specs.items()]
    return plan._replace(graph=Graph(specs))


def _builder(name: str, build: Callable[[], Node], memory: Memory) -> Callable[[], Node]:
    return lambda: _RememberingNode(name, build, memory)


class _RememberingNode:
    """A node that is built and executed only when it is given something new."""

    def __init__(self, name: str, build: Callable[[], Node], memory: Memory) -> None:
        self.name = name
        self._build = build
        self._memory = memory
        self._key = hashlib.blake2b(name.encode(), digest_size=16).digest()
        self._node: Node | None = None
        self._thawed: State | None = None
        self._ahead: list[Step] = []  # what the executed node has not been given yet
        self._known: _Known | None = None  # the last step

    def step(self, step: Step) -> Result:
        """Return the results of a step."""
        self._key = _digest(self._key, _ENCODER.encode(step))
        self._ahead.append(step)
        self._known = self._memory.get(self._key)
        if self._known is None:
            self._known = self._memory.put(self._key, self._catch_up())
        return self._known.result

    def freeze(self) -> State:
        """Return the whole state."""
        if self._known is None:
            self._catch_up()
            assert self._node is not None
            return self._node.freeze()
        if not self._known.state:
            self._catch_up()
            assert self._node is not None
            self._known.state.append(self._node.freeze())
        return self._known.state[0]

    def thaw(self, state: State) -> None:
        """Restore a state."""
        self._key = _digest(self._key[:0], encode_state(state), self.name.encode())
        self._thawed, self._node, self._known = state, None, None
        self._ahead.clear()

    def _catch_up(self) -> Result:
        """Execute what has been skipped, and return the last step's results."""
        if self._node is None:
            self._node = self._build()
            if self._thawed is not None:
                self._node.thaw(self._thawed)
        result = Result()
        for step in self._ahead:
            result = self._node.step(step)
        self._ahead.clear()
        return result


def _digest(*parts: bytes) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(part)
    return digest.digest()
