"""``dynpf play``: publish a recording onto the bus."""

import argparse
import sys
import time

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.arguments import add_connect, add_keys, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf play``."""
    add_recording(parser)
    parser.add_argument(
        "--rate",
        type=_rate,
        default=1.0,
        metavar="X",
        help="rate of playing, as a multiple of the recorded time (default 1)",
    )
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="only these topics")
    add_connect(parser, text="where a router listens")
    add_keys(parser)
    parser.set_defaults(run=run)


def _rate(text: str) -> float:
    rate = float(text)
    if not 0.0 < rate < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: expected a positive number")
    return rate


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf play`` and return its exit code."""
    from dynpf_formats.recording.reader import read_recording
    from dynpf_protocol.envelope import Envelope, encode_envelope
    from dynpf_protocol.errors import UsageError
    from dynpf_protocol.keys import data_key
    from dynpf_runtime.bus.access import PLAYER
    from dynpf_runtime.bus.session import Bus
    from dynpf_runtime.bus.terminal import StopSignal, say

    endpoint, keys = endpoint_of(options), credentials_of(options, PLAYER)
    recording = read_recording(options.recording)
    wanted = set(options.topics or ())
    present = {record.topic for record in recording.messages()}
    if lacking := sorted(wanted - present):
        raise UsageError(
            f"{options.recording}: has no {', '.join(lacking)}; its topics are {', '.join(sorted(present))}"
        )
    records = [record for record in recording.messages() if not wanted or record.topic in wanted]
    records.sort(key=lambda record: record.stamp_ns)  # stable: messages of the same stamp keep the order of the file
    with (
        StopSignal.installed() as stop,
        Bus.connect(endpoint, lambda text: say("play", text), lambda: stop.requested, keys) as bus,
    ):
        stop.wakes(bus.wake)
        began = time.monotonic()
        first_ns = records[0].stamp_ns if records else 0
        for count, record in enumerate(records):
            due = began + (record.stamp_ns - first_ns) * 1e-9 / options.rate
            while not stop.requested and (left := due - time.monotonic()) > 0:
                bus.receive(left)
            if stop.requested:
                print(f"played {count} of {len(records)} messages", file=sys.stderr)
                return 1
            tick = recording.tick_of(record) or 0
            envelope = Envelope(record.node, record.boot, record.sequence, tick, record.stamp_ns, time.time_ns())
            bus.put(data_key(record.topic, record.node), record.payload, encode_envelope(envelope))
    print(f"played {len(records)} messages")
    return 0
