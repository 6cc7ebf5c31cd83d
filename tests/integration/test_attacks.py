"""A few of the attacks of `python -m checks.attacks`, on real runs: on a plain bus, and with another's certificate."""

import pytest
from dynpf_protocol.keys import OBSERVER

from checks.attacks.kinds import KINDS
from checks.attacks.outcome import PLAIN, Fate, attacked, undisturbed


@pytest.fixture(name="expected", scope="module")
def content_of_an_undisturbed_run() -> str:
    return undisturbed()


@pytest.mark.parametrize(
    ("name", "role"),
    [("everything again", PLAIN), ("last ends of future ticks", PLAIN), ("stop in a node's name", OBSERVER)],
)
def test_a_stranger_changes_nothing(name: str, role: str, expected: str) -> None:
    outcome = attacked(KINDS[name], role, expected)
    assert outcome.acts
    assert outcome.fate is Fate.UNTOUCHED, outcome.text


def test_a_forged_message_is_not_overlooked(expected: str) -> None:
    """The control: nothing but a certificate prevents this."""
    outcomes = (attacked(KINDS["the next data, forged"], PLAIN, expected) for _ in range(5))
    told = next((outcome for outcome in outcomes if outcome.fate is Fate.TOLD), None)
    assert told is not None, "each came too late"
    assert "two messages that differ claim to be the message" in told.text
