"""The committed references are what the code says, and leave nothing out."""

from pathlib import Path

import pytest
from dynpf_formats.shipped import known_topics
from dynpf_services.scenario.kinds import fact_names
from dynpf_services.scenario.schema import RunTable

from docs.reference import PAGES, scenarios, topics


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_committed_reference_is_up_to_date(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == PAGES[path](), "make docs writes it anew"


def test_every_topic_and_its_type_is_described_and_linked() -> None:
    page = topics()
    for name, row in known_topics().items():
        schema = row.type.schema_name
        assert f"| `{name}` | [{schema}](#{schema.lower().replace('.', '')})" in page
        assert page.count(f"\n### {schema}\n") == 1


def test_units_ranges_and_defaults_are_told() -> None:
    page = topics()
    assert "| `range` | number | >= 0 | required | m |" in page
    assert "| `covariance` | list of number | 9 of them | required | m^2, m rad, rad^2 |" in page
    keys = scenarios()
    assert "| `tick_s` | number | > 0, <= 10 | 0.05 | the source's period |" in keys
    assert '## `[estimator]`, kind = "localization"' in keys
    assert "| `odometry_delay` | number | >= 0, <= 10 | 0 | Seconds between an odometry message" in keys


def test_every_table_of_a_scenario_has_its_section() -> None:
    page = scenarios()
    for name in (*RunTable.__struct_fields__, *fact_names()):
        assert f"| `{name}` |" in page
    for table in ("task", "simulator", "vision", "sensors", "estimator", "controller"):
        assert f"\n## `[{table}]`" in page
    assert "\n## `[[faults]]`" in page
