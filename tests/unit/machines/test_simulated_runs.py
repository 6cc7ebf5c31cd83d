"""Whole runs of the real machines on a simulated network: the same bytes whatever the network does to their order."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from dynpf_formats.importers.mrclam import import_mrclam
from dynpf_formats.importers.recording import write_recording
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.keys import BEAT, TICK
from dynpf_runtime.machines.deafness import AHEAD
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.node import Result
from dynpf_runtime.simulation import Network, Simulation
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario

from tests.unit.machines.conftest import Simulate
from tests.unit.services.toy_nodes import IDLE, ToyNode, graph_of, says

TICKS = {"landmark-room": 50, "landmark-filters": 10, "parts-3-tracked": 25}


def digest(path: Path) -> str:
    return content_digest(read_recording(path))


def scenario_of(name: str, *settings: str, seed: int | None = None) -> Scenario:
    return load_scenario(name, overrides=[f"max_ticks={TICKS.get(name, 20)}", *settings], seed=seed)


def story(simulation: Simulation) -> bytes:
    return "\n".join(map(repr, simulation.story)).encode()


@pytest.mark.parametrize("name", TICKS)
def test_a_run_has_the_inline_runs_bytes_whatever_the_network_does(
    name: str, tmp_path: Path, simulate: Simulate
) -> None:
    scenario = scenario_of(name)
    plan = plan_of(scenario)
    record_inline(scenario, tmp_path / "inline.mcap")
    expected = digest(tmp_path / "inline.mcap")
    orders = set()
    for seed in range(8):
        path = tmp_path / f"{seed}.mcap"
        # Some of these networks are slow to one, and some make everybody wait.
        simulation = simulate(plan, path, seed, network=Network(10 ** (4 + seed % 4), 10 ** (3 + seed % 3)))
        simulation.run()
        assert simulation.ended == dict.fromkeys(("router", "recorder", *plan.graph.nodes))
        assert digest(path) == expected
        recording = read_recording(path)
        assert recording.end is not None
        assert (recording.end.complete, recording.end.reason) == (True, "finished")
        orders.add(tuple((record.topic, record.sequence) for record in recording.records))
    assert len(orders) > 1, "the network has changed no order"
    record_inline(scenario_of(name, seed=2), tmp_path / "other.mcap")  # the control
    assert digest(tmp_path / "other.mcap") != expected


def test_the_same_seed_is_the_same_run_to_the_last_byte(tmp_path: Path, simulate: Simulate) -> None:
    plan = plan_of(scenario_of("landmark-room"))
    runs = {}
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        (tmp_path / folder).mkdir()
        path = Path(folder) / "run.mcap"
        with pytest.MonkeyPatch.context() as patch:  # the path is told, and shall be the same
            patch.chdir(tmp_path)
            patch.chdir(tmp_path / folder)
            simulation = simulate(plan, Path("run.mcap"), seed)
            simulation.run()
        runs[folder] = story(simulation), (tmp_path / path).read_bytes()
    assert runs["a"] == runs["b"]
    assert runs["a"] != runs["c"]


def test_a_log_is_played_by_its_source(tmp_path: Path, simulate: Simulate) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    for name, lines in mrclam_set().items():
        (folder / name).write_text("\n".join(lines) + "\n")
    write_recording(import_mrclam(folder), tmp_path / "log.mcap")
    log = PlayedLog(tmp_path / "log.mcap")
    scenario = load_scenario("landmark-mrclam", overrides=["max_ticks=30"], log=log.facts)
    record_inline(scenario, tmp_path / "inline.mcap", log)
    simulation = simulate(plan_of(scenario), tmp_path / "run.mcap", log=log.records)
    simulation.run()
    assert set(simulation.ended.values()) == {None}
    assert digest(tmp_path / "run.mcap") == digest(tmp_path / "inline.mcap")


def mrclam_set() -> dict[str, list[str]]:
    """Return the files of a made-up robot that drives straight ahead past a landmark."""
    times = [round(0.1 * number, 3) for number in range(60)]
    return {
        "Barcodes.dat": ["1 14", *(f"{number} {80 + number}" for number in range(2, 21))],
        "Landmark_Groundtruth.dat": [f"{number} {number - 5}.0 2.0 0.001 0.001" for number in range(6, 21)],
        "Robot1_Groundtruth.dat": [f"{time:.3f} {0.1 * time:.4f} 0.0 0.0" for time in times],
        "Robot1_Odometry.dat": [f"{time:.3f} 0.1 0.0" for time in times],
        "Robot1_Measurement.dat": [f"{time:.3f} 86 {2.2 - 0.02 * time:.3f} 1.1" for time in times[5::10]],
    }


FAULTS = """
[[faults]]
topic = "sensors/landmarks"
to = "estimator"
loss = 0.3
delay_s = 0.02
jitter_s = 0.15
"""


def test_a_realtime_run_over_a_bad_link_replays_exactly(tmp_path: Path, simulate: Simulate) -> None:
    text = (Path(__file__).parents[3] / "scenarios/dynpf_scenarios/landmark-room.toml").read_text()
    assert "tick_s" in text
    file = tmp_path / "bad-link.toml"
    file.write_text(text.replace("tick_s", 'clock = "realtime"\ntick_s', 1) + FAULTS)
    scenario = load_scenario(str(file), overrides=["max_ticks=40"])
    consumed = []
    for delay_ns in (10**6, 10**8):
        path = tmp_path / f"{delay_ns}.mcap"
        simulation = simulate(plan_of(scenario), path, network=Network(delay_ns))
        simulation.run()
        assert set(simulation.ended.values()) == {None}
        assert simulation.now_ns > 39 * scenario.tick_ns, "it went by the clock"
        assert main(["replay", str(path)]) == 0
        journal = read_recording(path).journal("estimator", "estimator-1")
        consumed.append([(entry.stamp_ns, entry.consumed) for entry in journal])
    assert consumed[0] != consumed[1], "the two networks have made no difference"


def test_the_source_waits_for_a_recorder_that_is_far_behind(tmp_path: Path, simulate: Simulate) -> None:
    source = ToyNode("simulator", writes=["controller/command"], act=lambda _: says("controller/command", IDLE))
    plan = plan_of(scenario_of("landmark-room"))._replace(graph=graph_of([source]), max_ticks=AHEAD + 500)
    simulation = simulate(plan, tmp_path / "run.mcap", network=Network(1000, 1000, 1000))
    simulation.run()
    assert set(simulation.ended.values()) == {None}
    ahead = max(ticks - known for ticks, known in _progress(simulation))
    assert ahead == AHEAD + 1, "it has not been so far ahead that it had to wait"
    end = read_recording(tmp_path / "run.mcap").end
    assert end is not None
    assert end.counts["journal/simulator"] == AHEAD + 500


def _progress(simulation: Simulation) -> Iterator[tuple[int, int]]:
    """Yield how many ticks the source has behind it, and the recorder as far as it has said."""
    ticks, behind = 0, 0
    for one in simulation.story:
        match one.what:
            case Put(key) if key == f"{TICK}simulator":
                ticks += 1
                yield ticks, behind
            case Put(key) if key == f"{BEAT}recorder":
                behind = max(behind, ticks)


def test_a_node_that_raises_is_named_and_the_others_break_off(tmp_path: Path, simulate: Simulate) -> None:
    def act(step: object) -> Result:
        if len(node.steps) == 4:
            raise IndexError("out of it")
        return Result()

    node = ToyNode("controller", act=act)
    plan = plan_of(scenario_of("landmark-room"))._replace(graph=graph_of([ToyNode("simulator"), node]))
    simulation = simulate(plan, tmp_path / "run.mcap")
    simulation.run()
    ended = {name: str(error) for name, error in simulation.ended.items()}
    assert ended["controller"].startswith("controller failed in step 3, tick 3: IndexError: out of it")
    assert (
        ended["simulator"]
        == "controller is gone (killed, crashed, stopped or cut off) after tick 4; the run cannot go on"
    )
    assert ended["recorder"].startswith("controller is gone")
    assert ended["router"].startswith("the run ended incomplete: controller is gone")
