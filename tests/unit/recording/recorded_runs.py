"""Made-up runs: a simulator and an estimator in lockstep, and what a test may want to change about them."""

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_formats.recording.header import Attachment, Provenance, RunHeader
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import (
    Consumed,
    JournalEntry,
    Produced,
    chain_after,
    decode_entry,
    encode_entry,
    genesis,
)
from dynpf_protocol.messages import Diagnostics, Estimate, RobotState
from dynpf_systems.parts.messages import Detection, Detections

MAP = Attachment(name="files/map.pgm", media_type="image/x-portable-graymap", data=bytes(range(256)))

_FILES = {"map.pgm": {"sha256": hashlib.sha256(MAP.data).hexdigest()}}
HEADER = RunHeader(
    scenario=json.dumps({"title": "Three nodes", "seed": 7, "files": _FILES}),
    seed=7,
    writes={"simulator": ("truth/robot",), "sensors": ("sensors/overhead",), "estimator": ("estimator/state",)},
    provenance=Provenance(
        dynpf_version="0.1.0", code_digest="c" * 64, packages={"numpy": "2.4.6"}, platform={"system": "Linux"}
    ),
)
NODELESS = msgspec.structs.replace(HEADER, writes={})
"""The header of a log, of whose messages no journal is expected."""

SECOND = 10**9


class Sent(NamedTuple):
    topic: str
    envelope: Envelope
    payload: bytes


def lockstep(ticks: int = 5, boot: str = "b1", wall_ns: int = 10**18) -> list[Sent]:
    """Return everything that three nodes send in some ticks, in the order of a tidy network."""
    sent = []
    for tick in range(ticks):
        stamp = tick * SECOND // 20

        def envelope(node: str, sequence: int = tick, tick: int = tick, stamp: int = stamp) -> Envelope:
            return Envelope(node, f"{node}-{boot}", sequence, tick, stamp, wall_ns + stamp)

        discs = tuple(Detection(x=0.1 * tick, y=0.2, radius=0.05, grey=9.0 + part) for part in range(3))
        overhead = encode("sensors/overhead", Detections(discs=discs), known_topics())
        sent += [
            Sent("truth/robot", envelope("simulator"), encode("truth/robot", RobotState(x=tick / 3, y=0.5, theta=0.1))),
            Sent("sensors/overhead", envelope("sensors"), overhead),
            Sent(
                "estimator/state",
                envelope("estimator"),
                encode("estimator/state", Estimate(x=tick / 7, y=1.0, theta=0.2, covariance=(0.1,) * 9, n_eff=50.0)),
            ),
            Sent(
                "diagnostics",
                envelope("estimator"),
                encode(
                    "diagnostics", Diagnostics(node="estimator", steps=tick, step_time_s=0.001, refused={}, queue=0)
                ),
            ),
            _entry(envelope("simulator"), [], ["truth/robot"], last=tick == ticks - 1),
            _entry(envelope("sensors"), ["truth/robot"], ["sensors/overhead"], last=tick == ticks - 1),
            _entry(envelope("estimator"), ["sensors/overhead"], ["estimator/state"], last=tick == ticks - 1),
        ]
    return chained(sent)


def _entry(envelope: Envelope, reads: list[str], writes: list[str], *, last: bool) -> Sent:
    tick = envelope.tick
    senders = {"truth/robot": "simulator", "sensors/overhead": "sensors"}
    run = envelope.boot.partition("-")[2]
    entry = JournalEntry(
        step=tick,
        tick=tick,
        stamp_ns=envelope.stamp_ns,
        consumed=tuple(Consumed(senders[name], f"{senders[name]}-{run}", name, tick) for name in reads),
        produced=tuple(Produced(name, tick) for name in writes),
        last=last,
        state=f"{tick:064x}" if last or tick % 2 == 0 else "",
    )
    return Sent(f"journal/{envelope.node}", envelope, encode_entry(entry))


def chained(sent: list[Sent], header: RunHeader = HEADER) -> list[Sent]:
    """Return what was sent with the chain values of its journals computed anew, as far as their messages are there."""
    known = {(one.topic, one.envelope.node, one.envelope.boot, one.envelope.sequence): one for one in reversed(sent)}
    chains: dict[str, bytes] = {}

    def link(one: Sent) -> Sent:
        node, boot = one.envelope.node, one.envelope.boot
        try:
            entry = decode_entry(one.payload)
        except msgspec.DecodeError:
            return one
        made = [known.get((made.topic, node, boot, made.sequence)) for made in entry.produced]
        messages = [(message.envelope.stamp_ns, message.payload) for message in made if message is not None]
        previous = chains.get(node) or genesis(node, header.scenario)
        chains[node] = chain_after(previous, boot, entry, messages)
        chain = chains[node].hex() if entry.state else ""
        return one._replace(payload=encode_entry(msgspec.structs.replace(entry, chain=chain)))

    return [link(one) if one.topic.startswith("journal/") else one for one in sent]


def write(
    path: Path,
    sent: list[Sent],
    *,
    complete: bool = True,
    close: bool = True,
    flush_every: int = 0,
    attachments: tuple[Attachment, ...] = (MAP,),
    header: RunHeader = HEADER,
) -> Path:
    """Write what was sent, its journals chained; every ``flush_every`` messages a chunk ends."""
    writer = RecordingWriter(path, header, attachments)
    now = 0
    writer.flush_if_due(now)
    for number, (topic, envelope, payload) in enumerate(chained(sent, header), 1):
        writer.message(topic, envelope, payload)
        if flush_every and number % flush_every == 0:
            now += SECOND
            writer.flush_if_due(now)
    if close:
        writer.close(complete, "finished")
    else:
        writer._file.close()  # as if the process had been killed
    return path


def changed(sent: list[Sent], topic: str, sequence: int, change: Callable[[Sent], Sent | None]) -> list[Sent]:
    """Return what was sent with one message changed, or left out where ``change`` returns None."""

    def apply() -> Iterator[Sent]:
        for one in sent:
            if one.topic == topic and one.envelope.sequence == sequence:
                replaced = change(one)
                if replaced is not None:
                    yield replaced
            else:
                yield one

    return list(apply())
