"""Conditions of ``dynpf why``: what they mean, and where they are wrong."""

import pytest
from dynpf_experiments.why.condition import Value, holds, parse
from dynpf_experiments.why.quantities import quantities_of
from dynpf_protocol.errors import UsageError
from dynpf_runtime.plan import Plan
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

VALUES: dict[str, Value] = {
    "position_error": 0.6,
    "time": 12.0,
    "estimator/state.health.status": "lost",
    "truth/parts.finished": False,
}


@pytest.mark.parametrize(
    ("text", "held"),
    [
        ("position_error > 0.5", True),
        ("position_error >= 6e-1 and time<12", False),
        ("time < 1 or time == 12", True),
        ("time < 1 and time == 0 or position_error > .5", True),  # "and" binds closer than "or"
        ("time < 1 and (time == 0 or position_error > .5)", False),
        ("not time < 1 and time < 20", True),  # and "not" closer than "and"
        ("not (time > 1 and time < 20)", False),
        ("estimator/state.health.status == 'lost'", True),
        ('estimator/state.health.status != "lost"', False),
        ("truth/parts.finished == false", True),
        ("heading_error > 0 or heading_error <= 0", False),  # it has no value
        ("-1 < 2", None),
    ],
)
def test_a_condition_means_what_it_says(text: str, held: bool | None) -> None:
    if held is None:
        with pytest.raises(UsageError, match="expected the name of a quantity"):
            parse(text)
    else:
        assert holds(parse(text), VALUES) is held


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_of(load_scenario("landmark-room"))


@pytest.mark.parametrize(
    ("text", "at", "problem"),
    [
        ("position_error > ", 17, "expected a number"),
        ("time > 1 and", 12, "expected the name"),
        ("(time > 1", 9, 'expected "\\)"'),
        ("time > 1 time", 9, 'expected "and", "or", or the end'),
        ("time ! 1", 5, "expected a name, a comparison"),
        ("time > 'soon'", 5, "compared by == and != alone"),
        ("not " * 60 + "time > 1", 204, "at most 50"),
        ("time > 1 and position_eror > 0.5", 13, "did you mean 'position_error'.*\n.*Quantities: position_error"),
        ("estimator/state.healht.status == 'lost'", 0, "has no healht; did you mean 'health'"),
        ("truth/robot > 1", 0, "no field of it is named"),
        ("estimator/state.health > 1", 0, "neither number, word"),
        ("estimator/state.n_eff == 'many'", 0, "expected a number"),
        ("__import__('os').system > 1", 10, "expected one of <"),
    ],
)
def test_an_error_points_at_its_place(text: str, at: int, problem: str, plan: Plan) -> None:
    with pytest.raises(UsageError, match=problem) as error:
        quantities_of(parse(text), text, plan)
    lines = str(error.value).splitlines()
    assert lines[1].strip() == text.strip()
    assert lines[2].index("^") - 2 == at
