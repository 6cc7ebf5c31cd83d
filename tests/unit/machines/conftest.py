"""Simulated runs whose recordings are closed when the test is over."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial

import pytest
from dynpf_runtime.simulation import Simulation

from tests.unit.machines.simulated_run import simulated

Simulate = Callable[..., Simulation]


@pytest.fixture(name="simulate")
def simulated_runs() -> Iterator[Simulate]:
    with ExitStack() as files:
        yield partial(simulated, files)
