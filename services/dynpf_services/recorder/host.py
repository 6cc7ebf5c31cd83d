"""The recorder process: a member of the run that takes everything and writes it down, outside the lockstep loop."""

import time
from collections import Counter
from pathlib import Path

from dynpf_formats.recording.header import Attachment, RunEnd
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import encode
from dynpf_protocol.control import Recorded, TickDone, decode_control, encode_control
from dynpf_protocol.envelope import Envelope, decode_envelope
from dynpf_protocol.errors import ProtocolError, RunError
from dynpf_protocol.messages import Log, LogLevel, timestamp
from dynpf_runtime.bus.intake import check_sender
from dynpf_runtime.bus.member import Member, StopSignal, join, say
from dynpf_runtime.bus.session import ALIVE, CONTROL, DATA, JOURNAL, TICK, Arrival
from dynpf_runtime.plan import Plan, run_header
from dynpf_runtime.progress import Progress

__all__ = ["run_recorder"]

FLUSH_POLL_S = 0.1
SETTLE_S = 3.0
"""How long the recorder waits, after the last step of every node, for messages that are still missing."""


def run_recorder(
    plan: Plan, endpoint: str, path: Path, attachments: tuple[Attachment, ...], stop: StopSignal
) -> RunEnd:
    """Record one run into ``path`` and return how it ended.

    Raises RunError if the run broke off, after closing the recording and marking it incomplete, and RecordingError if
    the file cannot be written.
    """
    with join("recorder", plan, endpoint, stop) as member:
        recorder = _Recorder(member, plan)
        for key in (f"{DATA}**", f"{JOURNAL}**", f"{TICK}**"):
            member.bus.subscribe(key)
        with RecordingWriter(path, run_header(plan), attachments, boot=member.boot, topics=plan.graph.topics) as writer:
            try:
                member.assemble(leads=False)
                end = recorder.record(writer)
            except (RunError, KeyboardInterrupt) as error:
                recorder.drain(writer)
                reason = str(error) or "stopped before the run began"
                end = writer.close(complete=False, reason=reason)
                recorder.confirm(end)
                raise
        recorder.confirm(end)
        recorder.see_off()
        if not end.complete:
            raise RunError(f"{path} is incomplete: {end.reason}")
        return end


class _Recorder:
    def __init__(self, member: Member, plan: Plan) -> None:
        self._member = member
        self._nodes = plan.graph.nodes
        self._graph = plan.graph
        self._promised: Counter[str] = Counter()
        self._received: Counter[str] = Counter()
        self._steps: dict[str, int] = {}
        self._entries: Counter[str] = Counter()
        self._ticks: dict[str, int] = {}
        self._last: set[str] = set()
        self._refused: Counter[str] = Counter()
        self._stamp_ns = 0
        self._progress = Progress()
        self._path = Path()

    def record(self, writer: RecordingWriter) -> RunEnd:
        """Take everything until every node has made its last step and all that it sent is here."""
        self._path = writer.path
        settled_by: float | None = None
        while not self._whole():
            if settled_by is None and len(self._last) == len(self._nodes):
                settled_by = time.monotonic() + SETTLE_S
                self._member.leaving = True
            if settled_by is not None and time.monotonic() > settled_by:
                return writer.close(complete=False, reason=self._lacking())
            self._take(self._member.poll(FLUSH_POLL_S), writer)
            writer.flush_if_due(time.monotonic_ns())
            self._progress.show(self._member.ticks, self._received.total())
        self._member.leaving = True
        return writer.close(complete=True, reason=self._member.stop_reason or "finished")

    def drain(self, writer: RecordingWriter) -> None:
        """Take what has already arrived."""
        while (arrival := self._member.bus.receive(0.0)) is not None:
            self._take(arrival, writer)

    def confirm(self, end: RunEnd) -> None:
        """Tell everybody that the file is closed."""
        self._progress.clear()
        self._member.leaving = True
        message = Recorded(end.complete, end.reason, str(self._path))
        self._member.bus.put(f"{CONTROL}recorded", encode_control(message))

    def see_off(self) -> None:
        """Wait a moment until the others have heard it and left."""
        bus, deadline = self._member.bus, time.monotonic() + 2.0
        while time.monotonic() < deadline and any(
            not key.startswith((f"{ALIVE}recorder/", f"{ALIVE}router/")) for key in bus.tokens(f"{ALIVE}**")
        ):
            bus.receive(0.05)

    def _take(self, arrival: Arrival | None, writer: RecordingWriter) -> None:
        if arrival is None:
            return
        try:
            if arrival.key.startswith(DATA):
                name, envelope = check_sender(arrival, self._member.boots, self._graph)
                writer.message(name, envelope, arrival.payload)
                self._received[name] += 1
            elif arrival.key.startswith(JOURNAL):
                envelope = decode_envelope(arrival.attachment)
                if self._member.boots.get(envelope.node) != envelope.boot:
                    raise ProtocolError(f"unknown sender {envelope.node!r} with boot {envelope.boot!r}")
                writer.journal(envelope, arrival.payload)
                self._entries[envelope.node] += 1
            elif arrival.key.startswith(TICK):
                self._tick(decode_control(arrival.payload, TickDone))
        except ProtocolError as error:
            self._refuse(arrival.key, str(error), writer)

    def _refuse(self, key: str, reason: str, writer: RecordingWriter) -> None:
        self._refused[key] += 1
        if self._refused[key] > 1:
            return
        text = f"{key}: message refused: {reason}"
        say("recorder", text)
        place = Envelope(
            "recorder", self._member.boot, len(self._refused) - 1, self._member.ticks, self._stamp_ns, time.time_ns()
        )
        message = Log(timestamp=timestamp(self._stamp_ns), level=LogLevel.WARNING, message=text, name="recorder")
        writer.message("log", place, encode("log", message))

    def _tick(self, done: TickDone) -> None:
        if self._member.boots.get(done.node) != done.boot:
            raise ProtocolError(f"unknown sender {done.node!r} with boot {done.boot!r}")
        self._promised.update(done.counts)
        self._steps[done.node] = done.step + 1
        self._ticks[done.node] = done.tick + 1
        self._stamp_ns = max(self._stamp_ns, done.stamp_ns)
        if done.last:
            self._last.add(done.node)
        self._member.ticks = min(self._ticks.get(node, 0) for node in self._nodes)

    def _whole(self) -> bool:
        return len(self._last) == len(self._nodes) and not self._missing()

    def _missing(self) -> dict[str, int]:
        missing = {topic: count - self._received[topic] for topic, count in self._promised.items()}
        missing |= {f"journal/{node}": steps - self._entries[node] for node, steps in self._steps.items()}
        return {topic: count for topic, count in missing.items() if count > 0}

    def _lacking(self) -> str:
        return "never arrived: " + ", ".join(f"{count} on {topic}" for topic, count in sorted(self._missing().items()))
