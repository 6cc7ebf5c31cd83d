"""Whether the recorder keeps up: messages of 200 bytes at a given rate through the router, none lost.

python benchmarks/recorder.py [--rate N] [--seconds S]

Starts a router and a recorder as their own processes, and takes the simulator's place itself.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.codec import encode
from dynpf_protocol.control import TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.journal import JournalEntry, Produced, encode_entry
from dynpf_protocol.messages import Log, LogLevel, timestamp
from dynpf_runtime.bus.member import Member, StopSignal, join
from dynpf_runtime.bus.processes import free_port
from dynpf_runtime.bus.session import DATA, JOURNAL, TICK
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import resolved_json

TICKS_PER_S = 100
SCENARIO = 'title = "Nothing but messages"\n[simulator]\nkind = "room"\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=int, default=5000, help="messages a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(Path(folder), options.rate, options.seconds)))


def measure(folder: Path, rate: int, seconds: float) -> dict[str, float]:
    """Publish for ``seconds`` and return what became of it."""
    (folder / "scenario.toml").write_text(SCENARIO)
    scenario = load_scenario(str(folder / "scenario.toml"))
    (folder / "scenario.json").write_text(resolved_json(scenario))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    service = [sys.executable, "-m", "dynpf_lab.cli.main", "service"]
    common = [str(folder / "scenario.json"), "--quiet"]
    router = subprocess.Popen([*service, "router", *common, "--listen", endpoint])
    output = folder / "run.mcap"
    recorder = subprocess.Popen([*service, "recorder", *common, "--connect", endpoint, "-o", str(output)])
    with StopSignal.installed() as stop, join("simulator", plan_of(scenario), endpoint, stop) as member:
        member.assemble(leads=True)
        began = time.monotonic()
        sent = publish(member, rate // TICKS_PER_S, int(seconds * TICKS_PER_S))
        took = time.monotonic() - began
        member.await_recorded()
        settled = time.monotonic() - began - took
    recorder.wait()
    router.wait()
    recording = read_recording(output)
    kept = sum(1 for _ in recording.messages("log"))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "messages_per_s": sent / took,
        "seconds": took,
        "sent": sent,
        "lost": sent - kept,
        "complete": bool(recording.end is not None and recording.end.complete),
        "settled_after_s": settled,
        "router_and_recorder_cpu_share": (used.ru_utime + used.ru_stime) / took,
    }


def publish(member: Member, per_tick: int, ticks: int) -> int:
    """Publish ``per_tick`` messages of 200 bytes in each of ``ticks`` ticks, with their journal."""
    bare = encode("log", Log(timestamp=timestamp(0), level=LogLevel.INFO, message="", name="simulator"))
    text = "x" * (200 - len(bare))
    payload = encode("log", Log(timestamp=timestamp(0), level=LogLevel.INFO, message=text, name="simulator"))
    assert len(payload) == 200
    began = time.monotonic()
    for tick in range(ticks):
        stamp_ns = tick * 10**9 // TICKS_PER_S
        first = tick * per_tick
        for sequence in range(first, first + per_tick):
            envelope = Envelope("simulator", member.boot, sequence, tick, stamp_ns, time.time_ns())
            member.bus.put(f"{DATA}log", payload, encode_envelope(envelope))
        last = tick + 1 == ticks
        done = TickDone("simulator", member.boot, tick, tick, stamp_ns, {"log": per_tick}, last)
        member.bus.put(f"{TICK}simulator", encode_control(done))
        made = tuple(Produced("log", sequence) for sequence in range(first, first + per_tick))
        entry = JournalEntry(step=tick, tick=tick, stamp_ns=stamp_ns, consumed=(), produced=made, last=last)
        envelope = Envelope("simulator", member.boot, tick, tick, stamp_ns, time.time_ns())
        member.bus.put(f"{JOURNAL}simulator", encode_entry(entry), encode_envelope(envelope))
        while (left := began + (tick + 1) / TICKS_PER_S - time.monotonic()) > 0:
            member.poll(left)
    return ticks * per_tick


if __name__ == "__main__":
    main()
