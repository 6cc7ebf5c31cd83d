"""What one lockstep tick costs on the bus beyond the nodes' own work, and how fast camera frames go round.

python benchmarks/lockstep_tick.py [--scenario NAME] [--ticks N] [--runs N] [--compare]

Each run starts every process. A tick is the time between two of the source's messages, from their publish times; the
nodes' own time is what they report of themselves. The first tenth of a run is left out. The floor is measured beside
each run: the same message of 100 bytes handed round five bare Zenoh clients through one router. ``--compare`` has each
run followed by one without keys, over plain tcp, and tells the ratio of the medians.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import Diagnostics
from dynpf_runtime.bus.processes import free_port
from dynpf_runtime.bus.session import Bus, open_router


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="landmark-room")
    parser.add_argument("--ticks", type=int, default=500)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--compare", action="store_true", help="with what it is without keys, in turns")
    options = parser.parse_args()
    rows, plain = [], []
    for _ in range(options.runs):
        rows.append(measure(options.scenario, options.ticks))
        print(json.dumps(rows[-1]))
        if options.compare:
            plain.append(measure(options.scenario, options.ticks, "--insecure"))
            print(json.dumps(plain[-1]))
    best = medians(rows)
    print("median of runs:", json.dumps(best))
    if plain:
        ratio = best["tick_median_ms"] / medians(plain)["tick_median_ms"]
        print("without keys:", json.dumps(medians(plain)), f"ratio {ratio:.3f}")


def medians(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the median of each measure."""
    return {key: float(np.median([row[key] for row in rows])) for key in rows[0]}


def measure(scenario: str, ticks: int, *words: str) -> dict[str, float]:
    """Run ``scenario`` for ``ticks`` on the bus; return milliseconds a tick and ticks a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        command = [sys.executable, "-m", "dynpf_lab.cli.main", "run", scenario, "-o", str(path), *words]
        subprocess.run([*command, "--set", f"max_ticks={ticks}"], check=True, stdout=subprocess.DEVNULL)
        recording = read_recording(path)
        published = np.array([record.publish_ns for record in recording.messages("truth/robot")]) * 1e-6
        spans = np.diff(published)[len(published) // 10 :]
        own, floor = own_time_ms(recording), floor_ms()
        return {
            "tick_median_ms": float(np.median(spans)),
            "tick_p95_ms": float(np.quantile(spans, 0.95)),
            "nodes_own_ms": own,
            "beyond_nodes_ms": float(np.median(spans)) - own,
            "ticks_per_s": float(1000.0 / np.mean(spans)),
            "floor_ms": floor,
            "ratio_to_floor": (float(np.median(spans)) - own) / floor,
        }


def floor_ms(laps: int = 500) -> float:
    """Return the median time of one lap round five bare processes and the router, in milliseconds."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    context = get_context("spawn")
    ready = [context.Event() for _ in range(5)]
    with open_router(endpoint):
        others = [context.Process(target=hand_on, args=(endpoint, place, ready[place])) for place in range(1, 5)]
        for process in others:
            process.start()
        with Bus.connect(endpoint, print, lambda: False) as bus:
            bus.subscribe("ring/0")
            for event in ready[1:]:
                event.wait()
            spans = []
            for _ in range(laps):
                began = time.perf_counter()
                bus.put("ring/1", bytes(100))
                bus.receive(5.0)
                spans.append(time.perf_counter() - began)
        for process in others:
            process.terminate()
            process.join()
    return 1000.0 * float(np.median(spans[laps // 10 :]))


def hand_on(endpoint: str, place: int, ready: Event) -> None:
    """Send whatever comes to ``place`` of the ring to the next."""
    with Bus.connect(endpoint, print, lambda: False) as bus:
        bus.subscribe(f"ring/{place}")
        ready.set()
        while True:
            arrival = bus.receive(60.0)
            if arrival is None:
                return
            bus.put(f"ring/{(place + 1) % 5}", arrival.payload)


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
