"""A simulated router that is stopped for longer than its connections last, and goes on or is replaced."""

from collections.abc import Iterator

import pytest
from dynpf_protocol.keys import ROUTER, SCENARIO
from dynpf_runtime.machines.effects import NEVER_NS, Ask, Effect
from dynpf_runtime.machines.events import Answered, Event, Now, Started, Woke
from dynpf_runtime.machines.router import RouterMachine
from dynpf_runtime.simulation import Network, Simulation
from dynpf_services.scenario.build import plan_of

from tests.unit.simulation.conftest import SCENARIO as HERE

PLAN = plan_of(HERE)
MS = 1_000_000


class Asker:
    """Asks the router for its scenario after four seconds."""

    def __init__(self) -> None:
        self.wake_ns = NEVER_NS
        self.answers: list[bytes | None] = []

    def handle(self, event: Event, now: Now) -> Iterator[Effect]:
        match event:
            case Started():
                self.wake_ns = now.monotonic_ns + 4000 * MS
            case Woke():
                self.wake_ns = NEVER_NS
                yield Ask(SCENARIO, PLAN.text.encode())
            case Answered(payload):
                self.answers.append(payload)


@pytest.mark.parametrize("replaced", [False, True])
def test_a_router_that_has_stood_still_answers_as_before(replaced: bool) -> None:
    simulation, asker = Simulation(1, ROUTER, Network(start_ns=1)), Asker()
    simulation.add(ROUTER, RouterMachine(PLAN, "router-1"))
    simulation.add("asker", asker)
    simulation.later(100 * MS, lambda: simulation.freeze(ROUTER, 2000 * MS))
    if replaced:  # by one that stands still for a moment just when the first would have been given up
        simulation.later(1000 * MS, lambda: simulation.restart(ROUTER, RouterMachine(PLAN, "router-2")))
        simulation.later(1500 * MS, lambda: simulation.freeze(ROUTER, 200 * MS))
    simulation.run(until=lambda: bool(asker.answers), limit_ns=6000 * MS)
    assert asker.answers == [PLAN.text.encode()]
    connections = simulation.processes["asker"].connection - replaced  # each router has one, too
    assert connections == 3, "the second router was given up with the first"
