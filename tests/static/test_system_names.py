"""The check for systems in generic code finds each word, however it is spelt, and lets plain English pass."""

import pytest

from checks.system_names import findings

NAMED = [
    "from dynpf_systems.parts.config import Noise",
    "import dynpf_systems.colon.tube",
    "from dynpf_protocol.messages import CapsuleEstimate, PartsState",
    "topic = 'estimator/capsule'",
    "run.topic('truth/parts')",
    "# of a COLON run",
    "count = len(estimate.parts)",
    "Estimate(x=1.0, parts=())",
    "part_radius = 0.1",
    "class PartEstimate: ...",
    "PARTS = 3",
    "load_scenario('parts-3-easy')",
    "def measure_rearrangement(): ...",
    "in_workspace = True",
    'KINDS = ("room", "tubes")',
]


@pytest.mark.parametrize("source", NAMED)
def test_finds_each_name_of_a_system(source: str) -> None:
    assert any(line.startswith("services/x.py:2: ") for line in findings(f"import math\n{source}", "services/x.py"))


def test_lets_plain_english_pass() -> None:
    source = '''
"""The parts of a study, which takes part in many runs."""

def check_part(part: str) -> str:
    parts = part.split()
    if parts == ["semicolon"]:
        partial = parts[0].partition(":")
    return "".join(parts)
'''
    assert findings(source, "services/x.py") == []
