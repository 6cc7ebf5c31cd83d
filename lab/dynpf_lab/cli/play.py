"""``dynpf play``: publish a recording onto the bus."""

import argparse
import sys
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.arguments import add_connect, add_keys, add_recording

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recorded, Recording
    from dynpf_protocol.envelope import Envelope

__all__ = ["add_arguments", "envelope_of", "played_messages"]


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
    from dynpf_protocol.envelope import encode_envelope
    from dynpf_protocol.keys import data_key
    from dynpf_runtime.bus.access import PLAYER
    from dynpf_runtime.bus.session import Bus
    from dynpf_runtime.bus.terminal import StopSignal, say

    endpoint, keys = endpoint_of(options), credentials_of(options, PLAYER)
    recording = read_recording(options.recording)
    played = played_messages(recording, options.topics or ())
    with (
        StopSignal.installed() as stop,
        Bus.connect(endpoint, lambda text: say("play", text), lambda: stop.requested, keys) as bus,
    ):
        stop.wakes(bus.wake)
        began = time.monotonic()
        first_ns = played[0].stamp_ns if played else 0
        for count, record in enumerate(played):
            due = began + (record.stamp_ns - first_ns) * 1e-9 / options.rate
            while not stop.requested and (left := due - time.monotonic()) > 0:
                bus.receive(left)
            if stop.requested:
                print(f"played {count} of {len(played)} messages", file=sys.stderr)
                return 1
            envelope = envelope_of(recording, record, time.time_ns())
            bus.put(data_key(record.topic, record.node), record.payload, encode_envelope(envelope))
    print(f"played {len(played)} messages")
    return 0


def played_messages(recording: "Recording", topics: Iterable[str] = ()) -> "list[Recorded]":
    """Return the messages of some topics, or of all, in the order in which they are published.

    Raises UsageError for a topic that the recording lacks, and for messages that cannot travel over the bus.
    """
    from dynpf_protocol.errors import UsageError

    wanted = set(topics)
    present = {record.topic for record in recording.messages()}
    if lacking := sorted(wanted - present):
        raise UsageError(f"{recording.path}: has no {', '.join(lacking)}; its topics are {', '.join(sorted(present))}")
    records = [record for record in recording.messages() if not wanted or record.topic in wanted]
    _check_travels(recording, records)
    return sorted(records, key=lambda record: record.stamp_ns)  # of the same stamp in the order of the file


def _check_travels(recording: "Recording", records: "list[Recorded]") -> None:
    """Raise UsageError unless topics, senders and stamps are such as the bus carries."""
    from dynpf_protocol.envelope import decode_envelope, encode_envelope
    from dynpf_protocol.errors import BadEnvelopeError, UsageError
    from dynpf_protocol.topics import TOPIC_NAME

    latest = {record.source: record for record in sorted(records, key=lambda record: record.stamp_ns)}
    for source, record in latest.items():
        where = f"{recording.path}: {source.topic!r} of {source.node!r} cannot be played"
        if TOPIC_NAME.fullmatch(source.topic) is None:
            raise UsageError(f"{where}: no topic of a bus; expected words of a-z, 0-9 and _ with / between")
        try:
            decode_envelope(encode_envelope(envelope_of(recording, record, 0)))
        except BadEnvelopeError as error:
            raise UsageError(f"{where}: {error}") from error


def envelope_of(recording: "Recording", record: "Recorded", now_ns: int) -> "Envelope":
    """Return the envelope with which a recorded message is published."""
    from dynpf_protocol.envelope import Envelope

    tick = recording.tick_of(record) or 0
    return Envelope(record.node, record.boot, record.sequence, tick, record.stamp_ns, now_ns)
