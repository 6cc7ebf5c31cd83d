"""What a process of a run loads: the nodes of its scenario, and nothing that measures or studies them."""

import subprocess
import sys

import pytest

BUILT = """
import sys
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
for spec in plan_of(load_scenario(sys.argv[1])).graph.specs.values():
    spec.build()
print(*sorted(name for name in sys.modules if name.startswith(("dynpf_systems", "dynpf_experiments"))))
"""


@pytest.mark.parametrize(
    ("scenario", "system"), [("parts-3-tracked", "parts"), ("colon-case-3", "colon"), ("landmark-room", "rooms")]
)
def test_building_a_scenarios_nodes_loads_no_measure_and_no_study(scenario: str, system: str) -> None:
    done = subprocess.run([sys.executable, "-c", BUILT, scenario], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert f"dynpf_systems.{system}.nodes" in loaded
    assert not [name for name in loaded if "measures" in name or "studies" in name or "experiments" in name]
