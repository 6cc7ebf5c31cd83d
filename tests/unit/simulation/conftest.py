"""Campaigns of a short run, whose nodes are executed once for all tests."""

from collections.abc import Iterator

import pytest
from dynpf_runtime.simulation.campaign import Campaign
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.simulate import campaign_of

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=10"])


@pytest.fixture(name="campaign", scope="package")
def a_campaign() -> Iterator[Campaign]:
    with campaign_of(SCENARIO, 1) as campaign:
        yield campaign
