"""What one lockstep tick costs on the bus beyond the nodes' own work, and how fast camera frames go round.

python benchmarks/lockstep_tick.py [--scenario NAME] [--ticks N] [--runs N]

Each run starts every process. A tick is the time between two of the source's messages, from their publish times; the
nodes' own time is what they report of themselves. The first tenth of a run is left out.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from protocol.codec import decode
from protocol.messages import Diagnostics
from services.recording.reader import Recording, read_recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="landmark-room")
    parser.add_argument("--ticks", type=int, default=500)
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    rows = [measure(options.scenario, options.ticks) for _ in range(options.runs)]
    for row in rows:
        print(json.dumps(row))
    best = {key: float(np.median([row[key] for row in rows])) for key in rows[0]}
    print("median of runs:", json.dumps(best))


def measure(scenario: str, ticks: int) -> dict[str, float]:
    """Run ``scenario`` for ``ticks`` on the bus; return milliseconds a tick and ticks a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        command = [sys.executable, "-m", "services.cli.main", "run", scenario, "-o", str(path)]
        subprocess.run([*command, "--set", f"max_ticks={ticks}"], check=True, stdout=subprocess.DEVNULL)
        recording = read_recording(path)
        published = np.array([record.publish_ns for record in recording.messages("truth/robot")]) * 1e-6
        spans = np.diff(published)[len(published) // 10 :]
        own = own_time_ms(recording)
        return {
            "tick_median_ms": float(np.median(spans)),
            "tick_p95_ms": float(np.quantile(spans, 0.95)),
            "nodes_own_ms": own,
            "beyond_nodes_ms": float(np.median(spans)) - own,
            "ticks_per_s": float(1000.0 / np.mean(spans)),
        }


def own_time_ms(recording: Recording) -> float:
    """Return the time that the nodes' steps take together, a tick, from their last reports."""
    last = {}
    for record in recording.messages("diagnostics"):
        message = decode("diagnostics", record.payload)
        assert isinstance(message, Diagnostics)
        last[message.node] = message.step_time_s / max(message.steps, 1)
    return 1000.0 * sum(last.values())


if __name__ == "__main__":
    main()
