"""The order in which the nodes of a run step in a tick."""

from collections.abc import Iterable, Mapping, Sequence

from dynpf_runtime.graph import NodeSpec

__all__ = ["in_tick_order"]

Upstream = Mapping[str, set[str]]
"""For each node, the nodes that write topics that it reads."""


def in_tick_order(specs: Sequence[NodeSpec], stages: Mapping[str, int | None]) -> list[NodeSpec]:
    """Return the nodes by stage, within a stage each after the nodes that it reads, else in the declared order.

    A node without a stage comes after the nodes that it reads. If nodes read each other in a cycle, the one declared
    first comes first and gets the others' messages a tick later.
    """
    writers = {row.name: spec.name for spec in specs for row in spec.writes.values()}
    upstream = {spec.name: {writers[topic] for topic in spec.reads if topic in writers} - {spec.name} for spec in specs}
    found = _with_stages([spec.name for spec in specs], stages, upstream)
    by_name = {spec.name: spec for spec in specs}
    ordered: list[NodeSpec] = []
    left = sorted(by_name, key=lambda name: found[name])  # stable: declared order within a stage
    while left:
        stage = [name for name in left if found[name] == found[left[0]]]
        ready = _first(stage, upstream)
        ordered.append(by_name[ready])
        left.remove(ready)
    return ordered


def _with_stages(names: Sequence[str], stages: Mapping[str, int | None], upstream: Upstream) -> dict[str, float]:
    """Return a stage for each node; a node without one comes between the last stage that it reads and the next."""
    found: dict[str, float] = {name: stage for name, stage in stages.items() if stage is not None}
    missing = [name for name in names if name not in found]
    while missing:
        name = _first(missing, upstream)
        before = [found[writer] for writer in upstream[name] if writer in found]
        found[name] = int(max(before, default=0.0)) + 0.5
        missing.remove(name)
    return found


def _first(names: Sequence[str], upstream: Upstream) -> str:
    """Return the first of ``names`` that waits for none of the others, or only for nodes that also wait for it."""
    waiting = set(names)
    behind = {name: _reached(name, upstream, waiting) for name in names}
    return next(name for name in names if all(name in behind[other] for other in behind[name]))


def _reached(name: str, upstream: Upstream, within: Iterable[str]) -> set[str]:
    """Return the nodes in the set ``within`` that a node waits for, directly or through others of the set."""
    reached: set[str] = set()
    new = upstream[name] & {*within}
    while new:
        reached |= new
        new = {writer for other in new for writer in upstream[other]} & {*within} - reached
    return reached
