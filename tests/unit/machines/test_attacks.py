"""What a stranger says on the bus, of every kind that there is, against whole runs on a simulated network.

The stranger knows the boots, which are public. It is refused; where nothing but a certificate could tell it from the
process in whose name it speaks, the run says that it is not to be trusted.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import DynpfError
from dynpf_protocol.keys import RUN
from dynpf_runtime.machines.effects import NEVER_NS, Answer, Declare, Effect, Put, Subscribe, Watch
from dynpf_runtime.machines.events import Arrived, Event, Now, Started, Token
from dynpf_runtime.simulation import Network, Simulation
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline
from hypothesis import given, settings
from hypothesis import strategies as st

from checks.attacks.kinds import KINDS, Kind, When
from checks.attacks.spy import Spy
from tests.unit.machines.conftest import Simulate
from tests.unit.machines.simulated_run import simulated

SCENARIO = load_scenario("landmark-room", overrides=["max_ticks=30"])
PLAN = plan_of(SCENARIO)
EVERYBODY = ("router", "recorder", *PLAN.graph.nodes)
STOPS = {"stop in a node's name", "stop as an operator"}


class Stranger:
    """The machine of an attacker, which hears everything and knows who is there."""

    wake_ns = NEVER_NS

    def __init__(self, kind: Kind) -> None:
        self.said = 0
        self._kind = kind
        self._spy = Spy()
        self._own: Counter[Arrived] = Counter()
        self._done = False

    def handle(self, event: Event, _now: Now) -> Iterator[Effect]:
        match event:
            case Started():
                yield from (Subscribe("dynpf/**"), Watch("dynpf/**"))
                if self._kind.when is When.JOINING:
                    yield from self._act()
            case Token(key, True):
                self._spy.token(key)
            case Arrived(key):
                if self._own[event]:
                    self._own[event] -= 1  # its own message has come back
                    return
                self._spy.hear(event)
                if key.startswith(RUN) and self._spy.ticks >= 12 and self._kind.when is not When.JOINING:
                    yield from self._act()

    def _act(self) -> Iterator[Effect]:
        if self._done or self.said > 5000:
            return
        self._done = self._kind.when is not When.THROUGHOUT
        for effect in self._kind.act(self._spy):
            if isinstance(effect, Put | Declare | Answer):  # the simulated network has nothing else
                self.said += 1
                if isinstance(effect, Put):
                    self._own[Arrived(*effect)] += 1
                yield effect


@pytest.fixture(name="undisturbed", scope="module")
def content_of_an_undisturbed_run(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("undisturbed") / "run.mcap"
    record_inline(SCENARIO, path)
    return content_digest(read_recording(path))


def attacked(simulation: Simulation, kind: Kind) -> int:
    """Simulate a run with a stranger on its bus, and return how much the stranger has said."""
    stranger = Stranger(kind)
    simulation.add("stranger", stranger)
    simulation.run(until=lambda: simulation.ended.keys() >= {*EVERYBODY}, limit_ns=100 * 10**9)
    return stranger.said


ELSEWHERE = {  # what the simulated network does not have, or a router that has to be stopped
    "deletions",
    "the scenario never answered",
    "a node's own token, declared and withdrawn",
    "all names taken before the run",
}


FORGED = sorted(name for name in KINDS.keys() - ELSEWHERE if KINDS[name].forged)


@pytest.mark.parametrize("name", sorted(KINDS.keys() - ELSEWHERE))
def test_a_stranger_changes_nothing_or_the_run_says_so(
    name: str, tmp_path: Path, simulate: Simulate, undisturbed: str
) -> None:
    kind, path = KINDS[name], tmp_path / "run.mcap"
    simulation = simulate(PLAN, path, len(name), network=Network(start_ns=0))
    assert attacked(simulation, kind)
    assert "stranger" not in simulation.ended
    check(simulation, kind, path, undisturbed)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(name=st.sampled_from(FORGED), seed=st.integers(0, 2**32), delay_ns=st.sampled_from([10**4, 10**6, 10**7]))
def test_whatever_the_network_does_a_forged_run_says_so(
    name: str, seed: int, delay_ns: int, tmp_path_factory: pytest.TempPathFactory, undisturbed: str
) -> None:
    path = tmp_path_factory.mktemp("forged") / "run.mcap"
    with ExitStack() as files:
        simulation = simulated(files, PLAN, path, seed, network=Network(delay_ns, start_ns=0))
        attacked(simulation, KINDS[name])
        check(simulation, KINDS[name], path, undisturbed)


REALTIME = {
    "data two sequences ahead": False,
    "data 10^6 sequences ahead": True,
    "everything again": True,
    "end of tick that promises 10^9": True,
    "last ends of future ticks": True,
    "old last ends of ticks": True,
    "journal entries ahead": True,
    "the next data, forged": False,
}
"""Kinds of attack, and whether they change nothing in realtime, where a node cannot know what is sent to it."""


@pytest.mark.parametrize("name", REALTIME)
def test_a_realtime_run_is_whole_and_replays_or_says_that_it_is_not(
    name: str, tmp_path: Path, simulate: Simulate
) -> None:
    path = tmp_path / "run.mcap"
    plan = plan_of(load_scenario("landmark-room", overrides=["max_ticks=30", "clock=realtime"]))
    simulation = simulate(plan, path, len(name), network=Network(start_ns=0))
    assert attacked(simulation, KINDS[name])
    assert simulation.ended.keys() >= {*EVERYBODY}
    end = read_recording(path).end
    assert end is not None
    assert end.complete or not REALTIME[name]
    if end.complete:
        assert main(["replay", str(path)]) == 0
    else:
        assert any(text in end.reason for text in ("claim to be", "has come twice", "never arrived"))
    counts = {end.counts[f"journal/{node}"] for node in ("simulator", "sensors")}
    assert min(counts) >= 30 or not end.complete  # nobody has ended before the source


def check(simulation: Simulation, kind: Kind, path: Path, undisturbed: str) -> None:
    """Check that a run that was attacked is what it would have been, or says that it is not."""
    recording = read_recording(path)
    end = recording.end
    assert end is not None
    errors = {who: error for who, error in simulation.ended.items() if error is not None}
    assert all(isinstance(error, DynpfError) for error in errors.values()), errors
    if not kind.forged:
        assert not errors
        assert end.complete
    if end.complete and kind.name not in STOPS:
        assert content_digest(recording) == undisturbed
    if not end.complete:
        assert errors
        assert any(text in end.reason for text in ("claim to be", "has come twice", "has not read"))
    texts = [text for who in EVERYBODY for text in simulation.notices(who)]
    assert len(texts) < 150
    assert not [text for text in (*texts, end.reason) if not text.isprintable()]
