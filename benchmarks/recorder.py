"""Whether the recorder keeps up: messages of 200 bytes at a given rate through the router, none lost.

python benchmarks/recorder.py [--rate N] [--seconds S] [--insecure]

The bus is encrypted, and says who may say what, unless ``--insecure``. Starts a router and a recorder as their own
processes, and takes the simulator's place itself.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.codec import encode
from dynpf_protocol.keys import RECORDER, ROUTER
from dynpf_protocol.messages import Log, LogLevel, timestamp
from dynpf_protocol.topics import TOPICS
from dynpf_runtime.bus.host import run_node
from dynpf_runtime.bus.keys import load, run_keys
from dynpf_runtime.bus.processes import free_port
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.terminal import StopSignal
from dynpf_runtime.graph import Graph, NodeSpec
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import resolved_json

TICKS_PER_S = 100
SCENARIO = 'title = "Nothing but messages"\n[simulator]\nkind = "room"\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=int, default=5000, help="messages a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--insecure", action="store_true", help="without keys, over plain tcp")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        keys = None if options.insecure else Path(folder) / "keys"
        owners = {} if keys is None else {keys: (ROUTER, RECORDER, "simulator")}
        with run_keys(owners, datetime.now(UTC)):
            print(json.dumps(measure(Path(folder), options.rate, options.seconds, keys)))


def measure(folder: Path, rate: int, seconds: float, keys: Path | None) -> dict[str, float]:
    """Publish for ``seconds`` and return what became of it."""
    (folder / "scenario.toml").write_text(SCENARIO)
    scenario = load_scenario(str(folder / "scenario.toml"))
    (folder / "scenario.json").write_text(resolved_json(scenario))
    endpoint = f"{'tcp' if keys is None else 'tls'}/127.0.0.1:{free_port()}"
    service = [sys.executable, "-m", "dynpf_lab.cli.main", "service"]
    common = [str(folder / "scenario.json"), "--quiet", *([] if keys is None else ["--keys", str(keys)])]
    router = subprocess.Popen([*service, "router", *common, "--listen", endpoint])
    output = folder / "run.mcap"
    recorder = subprocess.Popen([*service, "recorder", *common, "--connect", endpoint, "-o", str(output)])
    log = {"log": TOPICS["log"]}
    chatters: list[Chatter] = []

    def build() -> Chatter:
        chatters.append(Chatter(rate // TICKS_PER_S))
        return chatters[-1]

    plan = plan_of(scenario)
    graph = Graph([NodeSpec("simulator", "chatter", build, reads={}, writes=log)])
    plan = plan._replace(graph=graph, rate=1.0, tick_ns=10**9 // TICKS_PER_S, max_ticks=int(seconds * TICKS_PER_S))
    with StopSignal.installed() as stop:
        own = None if keys is None else load(keys, "simulator", datetime.now(UTC))
        run_node("simulator", plan, endpoint, [], stop, pulse=Pulse.private(), keys=own)
    chatter = chatters[-1]  # the others rehearsed
    settled = time.monotonic() - chatter.ended
    took = chatter.ended - chatter.began
    sent = chatter.sent
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


class Chatter:
    """Says ``count`` messages of 200 bytes in each tick, and when it began and ended."""

    name = "simulator"

    def __init__(self, count: int) -> None:
        self.count = count
        self.sent = 0
        self.began = self.ended = 0.0
        bare = encode("log", self._message(""))
        self._output = Output("log", self._message("x" * (200 - len(bare))))

    def step(self, _step: Step) -> Result:
        self.ended = time.monotonic()
        self.began = self.began or self.ended
        self.sent += self.count
        return Result((self._output,) * self.count)

    def freeze(self) -> State:
        return {}

    def thaw(self, state: State) -> None: ...

    def _message(self, text: str) -> Log:
        return Log(timestamp=timestamp(0), level=LogLevel.INFO, message=text, name=self.name)


if __name__ == "__main__":
    main()
