"""After its rehearsal a node compiles nothing any more: whatever steps call, it has called with the same types."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from dynpf_runtime.executor import Executor
from dynpf_runtime.node import Node, Rehearsing, encode_state
from dynpf_services.scenario.build import build_nodes
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario
from dynpf_systems.rooms.localization import estimator as localization

from dynpf import kernels
from dynpf.portable import rehearse
from tests.unit.estimator.test_compositions import COMPOSITIONS, scenario

KERNELS = Path(next(iter(kernels.__path__)))
_OF_KERNELS_ALONE = {"__init__", "compiler", "elementary", "elementary64"}
MODULES = [file.stem for file in sorted(KERNELS.glob("*.py")) if file.stem not in _OF_KERNELS_ALONE]
Calls = set[tuple[str, tuple[str, ...]]]


class Watched:
    """A module of kernels as Python code reaches it; takes down each call and the types that numba compiles it for."""

    def __init__(self, module: ModuleType, calls: Calls) -> None:
        self._module = module
        self._calls = calls

    def __getattr__(self, name: str) -> Any:
        function = getattr(self._module, name)
        if not callable(function):  # a constant
            return function

        def call(*arguments: Any) -> Any:
            types = tuple(str(function.typeof_pyval(one)) for one in arguments)
            self._calls.add((f"{self._module.__name__}.{name}", types))
            return function(*arguments)

        return call


@pytest.fixture(name="calls")
def watched_calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Collect the calls of all kernels."""
    calls: Calls = set()
    for name in MODULES:
        monkeypatch.setattr(kernels, name, Watched(getattr(kernels, name), calls))
    return calls


def calls_of_steps(composed: Scenario, calls: Calls, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Return what the steps of the estimator call in a run."""
    of_steps: Calls = set()
    step = Executor.step

    def watched(self: Executor, *arguments: Any) -> Any:
        calls.clear()
        done = step(self, *arguments)
        if self.spec.name == "estimator":
            of_steps.update(calls)
        return done

    monkeypatch.setattr(Executor, "step", watched)
    record_inline(composed, tmp_path / "run.mcap")
    return of_steps


@pytest.mark.parametrize("name", [*COMPOSITIONS, "parts-3-tracked"])
def test_steps_call_nothing_that_the_rehearsal_has_not_called(
    name: str, calls: Calls, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    composed = (
        scenario(**COMPOSITIONS[name]) if name in COMPOSITIONS else load_scenario(name, overrides=["max_ticks=40"])
    )
    node = build_nodes(composed)["estimator"]
    calls.clear()
    before = encode_state(node.freeze())
    rehearsed(node)
    assert encode_state(node.freeze()) == before
    prepared = set(calls)
    of_steps = calls_of_steps(composed, calls, tmp_path, monkeypatch)
    assert of_steps, "a filter calls kernels"
    assert of_steps <= prepared, of_steps - prepared
    for kernel in {kernel for kernel, _ in prepared}:
        assert len([types for other, types in prepared if other == kernel]) == 1, prepared


def test_a_rehearsal_without_readings_would_be_found_out(
    calls: Calls, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    composed = scenario(**COMPOSITIONS["likelihood_field"])
    node = build_nodes(composed)["estimator"]
    calls.clear()
    monkeypatch.setattr(localization, "example_readings", lambda *_, **__: ())
    rehearsed(node)
    prepared = set(calls)
    missing = calls_of_steps(composed, calls, tmp_path, monkeypatch) - prepared
    assert {kernel.rpartition(".")[2] for kernel, _ in missing} >= {"find_beam_ends", "sum_over_beams", "normalize"}


COUNT = """
import sys
from pathlib import Path
from dynpf import kernels
from dynpf.portable import rehearse
from dynpf_runtime.node import Rehearsing
from dynpf_services.scenario.build import build_nodes
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.load import load_scenario

def count():
    loaded = [module for name, module in sys.modules.items() if name.startswith("dynpf.kernels.")]
    found = [one for module in loaded for one in vars(module).values() if hasattr(one, "signatures")]
    return sum(len(one.signatures) for one in {id(one): one for one in found}.values())

scenario = load_scenario("room-scan", overrides=["max_ticks=12"])
if sys.argv[2] == "rehearsed":
    rehearse()
    for node in build_nodes(scenario).values():
        if isinstance(node, Rehearsing):
            node.rehearse()
before = count()
record_inline(scenario, Path(sys.argv[1]) / f"{sys.argv[2]}.mcap")
print(before, count())
"""


def test_numba_itself_compiles_nothing_in_a_run_that_was_rehearsed(tmp_path: Path) -> None:
    def counts(how: str) -> list[int]:
        words = [sys.executable, "-c", COUNT, str(tmp_path), how]
        told = subprocess.run(words, capture_output=True, text=True, check=True)
        return [int(word) for word in told.stdout.split()]

    before, after = counts("rehearsed")
    assert before == after > 5
    before, after = counts("at once")
    assert after - before > 5


def rehearsed(node: Node) -> None:
    assert isinstance(node, Rehearsing)
    rehearse()  # as the host does
    node.rehearse()
