"""Runs for studies: a scenario as ``dynpf run`` runs it, in this process, observed instead of recorded.

``recorded_in`` turns the sink on: every run then goes into a recording, too.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from dynpf_runtime.inline import run_inline
from dynpf_runtime.node import Node, Received
from dynpf_services.scenario.build import build_node, plan_of
from dynpf_services.scenario.record import Log, record_inline
from dynpf_services.scenario.schema import Scenario

from dynpf_lab.measures.messages import Observed, RunMessages

__all__ = ["drive", "recorded_in"]

_FOLDER: ContextVar[Path | None] = ContextVar("folder of recordings", default=None)


@contextmanager
def recorded_in(folder: Path) -> Iterator[None]:
    """Record each run of a scenario's own nodes, while this holds, as ``folder``/0.mcap, 1.mcap and so on."""
    token = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(token)


def drive(
    scenario: Scenario,
    topics: Collection[str],
    log: Log | None = None,
    *,
    others: Mapping[str, Node] | None = None,
    stopped: Callable[[Received], bool] | None = None,
) -> RunMessages:
    """Run ``scenario`` to its end and return its messages of some topics.

    ``log`` is what the sensors play, if they play one. ``others`` are nodes that take the place of the scenario's of
    the same names: such a run is never recorded. The tick after one with a
    message of these topics for which ``stopped`` says so is the last. Raises what the nodes raise.
    """
    observed = Observed(topics)
    ending = False

    def observe(received: Received) -> None:
        nonlocal ending
        observed(received)
        if stopped is not None and received.topic in topics and stopped(received):
            ending = True

    folder = _FOLDER.get()
    if folder is not None and not others:
        path = folder / f"{len(list(folder.glob('*.mcap')))}.mcap"
        record_inline(scenario, path, log, observe=observe, stopped=lambda: "enough was seen" if ending else "")
        return observed.run_of(scenario)
    plan = plan_of(scenario)
    if others:
        plan = plan._replace(
            build=lambda: {name: others.get(name) or build_node(scenario, name) for name in scenario.nodes}
        )
    run_inline(plan, log.records if log else (), observe=observe, stopped=lambda: ending)
    return observed.run_of(scenario)
