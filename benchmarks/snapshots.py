"""What snapshots cost: their share of a recording, and of the processor time of a run in one process.

`python benchmarks/snapshots.py [SCENARIO[=TICKS][@LOG.mcap] ...]` runs each scenario twice, with and without snapshots,
and prints a row of the table in docs/recording.md for it. Scenarios that play an imported log are run only if named.
"""

import sys
import tempfile
from pathlib import Path
from time import process_time

from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_runtime.snapshot import Snapshots
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import record_inline

SCENARIOS = {
    "landmark-room": 1500,
    "landmark-filters": 1500,
    "room-scan": 1500,
    "room-lines": 1500,
    "indoor-global": 1500,
    "indoor-tracking": 1500,
    "turtlebot-room": 900,
    "turtlebot-loops": 1500,
    "parts-3-tracked": 1500,
    "parts-3-easy": 300,
    "colon-case-5": 20,
}


def measured(name: str, ticks: int, log: PlayedLog | None, folder: Path) -> str:
    """Return the row of a scenario, which may play a log."""
    facts = None if log is None else log.facts
    scenario = load_scenario(name, overrides=[f"max_ticks={ticks}"], log=facts)
    spent = [0.0]
    after = Snapshots.after

    def timed(self: Snapshots, *arguments, **named):
        began = process_time()
        try:
            return after(self, *arguments, **named)
        finally:
            spent[0] += process_time() - began

    try:
        Snapshots.after = timed
        began = process_time()
        made = record_inline(scenario, folder / f"{name}.mcap", log)
        whole = process_time() - began
        Snapshots.after = lambda *_, **__: None
        record_inline(scenario, folder / f"{name}-without.mcap", log)
    finally:
        Snapshots.after = after
    sizes = [(folder / f"{name}{which}.mcap").stat().st_size for which in ("", "-without")]
    recording = read_recording(folder / f"{name}.mcap")
    kept = sum(topic.startswith(SNAPSHOT_PREFIX) for topic in (one.topic for one in recording.messages()))
    file, processor = (sizes[0] - sizes[1]) / sizes[1], spent[0] / whole
    return f"| {name} | {made} | {kept} | {100 * file:.1f} % | {100 * processor:.1f} % |"


def main() -> None:
    """Print the table."""
    print("| scenario | ticks | snapshots | of the file | of the processor time |\n| --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        record_inline(load_scenario("landmark-room", overrides=["max_ticks=3"]), Path(folder) / "first.mcap")
        for word in sys.argv[1:] or SCENARIOS:
            chosen, _, path = word.partition("@")
            name, _, ticks = chosen.partition("=")
            log = PlayedLog(Path(path)) if path else None
            print(measured(name, int(ticks or SCENARIOS.get(name, 1500)), log, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
