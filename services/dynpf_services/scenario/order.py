"""The order in which the nodes of a run take their turn in a tick."""

from collections.abc import Mapping, Sequence

from dynpf_runtime.graph import NodeSpec

__all__ = ["in_tick_order"]


def in_tick_order(specs: Sequence[NodeSpec], stages: Mapping[str, int | None]) -> list[NodeSpec]:
    """Return the nodes by stage, within a stage each after those that it reads, else as they are declared.

    A node without a stage of its own takes its turn behind those that it reads. Where nodes read each other in a
    circle, the one that is declared first comes first and hears of the others a tick later.
    """
    writers = {row.name: spec.name for spec in specs for row in spec.writes.values()}
    upstream = {spec.name: {writers[topic] for topic in spec.reads if topic in writers} - {spec.name} for spec in specs}
    found = _with_stages(specs, stages, upstream)
    ordered: list[NodeSpec] = []
    left = sorted(specs, key=lambda spec: found[spec.name])  # stable: in a stage as declared
    while left:
        stage = [spec for spec in left if found[spec.name] == found[left[0].name]]
        waiting = {spec.name for spec in stage}
        ready = next((spec for spec in stage if not upstream[spec.name] & waiting), stage[0])
        ordered.append(ready)
        left.remove(ready)
    return ordered


def _with_stages(
    specs: Sequence[NodeSpec], stages: Mapping[str, int | None], upstream: Mapping[str, set[str]]
) -> dict[str, float]:
    """Return a stage for each node; those without one are between the stage that they read and the next."""
    found: dict[str, float] = {name: stage for name, stage in stages.items() if stage is not None}
    missing = [spec.name for spec in specs if spec.name not in found]
    while missing:
        known = [name for name in missing if upstream[name] & found.keys()] or missing[:1]
        for name in known:
            before = [found[writer] for writer in upstream[name] if writer in found]
            found[name] = int(max(before, default=0.0)) + 0.5
            missing.remove(name)
    return found
