"""The recorder process: the recorder's machine on the bus, and its file."""

import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Self

from dynpf_formats.recording.errors import RecordingError, RecordingExistsError
from dynpf_formats.recording.header import Attachment, RunEnd, RunHeader
from dynpf_formats.recording.mcap_records import Damage, End
from dynpf_formats.recording.stream import StreamedMessage, stream
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.regular_files import readable
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry
from dynpf_protocol.keys import RECORDER
from dynpf_protocol.topics import LOG_NODE
from dynpf_runtime.bus.edge import drive, new_boot
from dynpf_runtime.bus.keys import Credentials
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.effects import Close, Effect, Flush, Mend, Open, Record, Show
from dynpf_runtime.machines.events import Closed, Event, Flushed, Found, FoundMessage
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.plan import Plan, run_header
from dynpf_runtime.progress import Progress

__all__ = ["RecorderFile", "recorded_boots", "run_recorder"]


def run_recorder(
    plan: Plan,
    endpoint: str,
    path: Path,
    attachments: tuple[Attachment, ...],
    stop: StopSignal,
    *,
    pulse: Pulse,
    keys: Credentials | None = None,
    patience_s: float = 0.0,
    durable: bool = False,
    resume: bool = False,
) -> RunEnd:
    """Record one run into ``path`` and return how it ended. Processes that are gone are waited for ``patience_s``.

    A ``durable`` recording survives a loss of power as far as the recorder has confirmed it. With ``resume`` the run of
    the recording, of which all processes are gone, goes on.

    Raises RunError if the run broke off, after closing the recording and marking it incomplete, and RecordingError if
    the file cannot be written.
    """
    boot = new_boot()
    name = os.fsencode(path).decode(errors="backslashreplace")  # it travels, and need not be UTF-8
    patience_ns = round(patience_s * 1e9)
    machine = RecorderMachine(
        plan,
        boot,
        endpoint,
        name,
        patience_ns=patience_ns,
        exists=path.exists(),
        resumes=recorded_boots(path, plan) if resume else None,
    )
    with (
        Bus.connect(endpoint, lambda text: say(RECORDER, text), lambda: stop.requested, keys) as bus,
        RecorderFile(plan, boot, path, attachments, durable=durable) as file,
    ):
        drive(RECORDER, machine, bus, stop, file.perform, pulse=pulse)
    assert file.end is not None, "the machine has ended without an error and without a recording"
    return file.end


class RecorderFile:
    """Carries out the effects of a recorder's machine on the file: opens, writes and closes the recording.

    It is written into a draft beside ``path`` until it has its header, or all that another start of the recorder had
    recorded. If an error leaves the context while the file is open, the recording's end names the error.
    """

    def __init__(
        self,
        plan: Plan,
        boot: str,
        path: Path,
        attachments: Sequence[Attachment] = (),
        open_writer: Callable[..., RecordingWriter] = RecordingWriter,
        *,
        durable: bool = False,
    ) -> None:
        self.end: RunEnd | None = None
        self._open_writer = partial(open_writer, durable=durable)
        self._plan, self._boot, self._path, self._attachments = plan, boot, path, tuple(attachments)
        self._writer: RecordingWriter | None = None
        self._placed = False
        self._progress = Progress(plan.max_ticks)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if self._writer is not None and self.end is None:
            self._progress.clear()
            if self._placed:
                self._writer.close(
                    complete=False, reason=f"ended by {kind.__name__}: {error}" if kind else "never closed"
                )
            else:
                self._writer.discard()

    def perform(self, effect: Effect) -> Event | None:
        """Carry out an effect; raises RecordingError."""
        match effect:
            case Record():
                self._open.message(*effect)
            case Open():
                return self._begin(again=effect.again, anew=effect.anew)
            case Mend():
                self._place(replace=True)
                return Flushed()
            case Flush(now_ns):
                return Flushed() if self._placed and self._open.flush_if_due(now_ns) else None
            case Show(ticks, messages, paused):
                self._progress.show(ticks, messages, paused=paused)
            case Close(complete, reason, outcome):
                self._progress.clear()
                self.end = self._open.close(complete=complete, reason=reason, outcome=outcome)
                return Closed(self.end)
            case _:
                raise TypeError(f"a recorder's file does not carry out {effect!r}")
        return None

    def _begin(self, *, again: bool, anew: bool) -> Event | None:
        """Open the recording, or go on with the one that another start of the recorder has begun."""
        end = _whole_end(self._path, self._plan) if again else None
        if end is not None and not (anew and end.stopped):
            self.end = end
            return Closed(end)
        exists = self._path.exists()
        if exists and not again and not _is_blank(self._path, self._plan):
            raise RecordingExistsError(f"{self._path}: the file exists; choose another name or overwrite it")
        draft = self._path.with_name(f".{self._path.name}.draft")
        header, topics = run_header(self._plan), self._plan.graph.topics
        self._writer = self._open_writer(
            self._path, header, self._attachments, draft=draft, boot=self._boot, topics=topics
        )
        if exists and again:
            return Found(_messages(self._path, self._plan))
        self._place(replace=exists)
        return None

    def _place(self, *, replace: bool) -> None:
        self._open.place(replace=replace)
        self._placed = True

    @property
    def _open(self) -> RecordingWriter:
        assert self._writer is not None, "the recording is not open"
        return self._writer


def _messages(path: Path, plan: Plan) -> Iterator[FoundMessage]:
    """Yield what can be read of a recording of ``plan``; raises RecordingError if it is of another."""
    for item in stream(path):
        match item:
            case RunHeader():
                _check_header(path, item, plan)
            case StreamedMessage(source=source) if source is not None:
                envelope = Envelope(source.node, source.boot, item.sequence, 0, item.stamp_ns, item.publish_ns)
                yield FoundMessage(source.topic, envelope, item.payload)


def recorded_boots(path: Path, plan: Plan) -> dict[str, str]:
    """Return the boots of the nodes by a recording of ``plan``, and the last of its recorder.

    A node of which the file has lost everything is known by who has read its messages; one of which nothing is recorded
    gets a new boot. Raises RecordingError if there is no such recording, or if a node has several.
    """
    boots: dict[str, str] = {}
    read: dict[str, str] = {}
    source = plan.graph.source
    for topic, envelope, payload in _messages(path, plan):
        if topic.startswith(JOURNAL_PREFIX) and not boots.keys() >= {*plan.graph.nodes}:
            read |= {one.node: one.boot for one in decode_entry(payload).consumed if one.node in plan.graph.nodes}
        node = source if envelope.node == LOG_NODE else envelope.node
        if node != RECORDER and boots.get(node, envelope.boot) != envelope.boot:
            raise RecordingError(f"{path}: {readable(node)} has several boots: no run of one start can go on from it")
        boots[node] = envelope.boot
    return {name: boots.get(name) or read.get(name) or new_boot() for name in (*plan.graph.nodes, RECORDER)}


def _check_header(path: Path, header: RunHeader, plan: Plan) -> None:
    if header.scenario != plan.text:
        raise RecordingError(f"{path}: is a recording of another scenario; choose another name")


def _is_blank(path: Path, plan: Plan) -> bool:
    """Return whether a file is a recording of ``plan`` in which nothing is recorded: a run that never began."""
    try:
        return next(_messages(path, plan), None) is None
    except RecordingError:
        return False


def _whole_end(path: Path, plan: Plan) -> RunEnd | None:
    """Return the end of a recording of ``plan`` that is whole, or None."""
    if not path.exists():
        return None
    found, ended = None, False
    for item in stream(path):
        match item:
            case RunHeader():
                _check_header(path, item, plan)
            case RunEnd():
                found = item
            case Damage():
                return None
            case End():
                ended = True  # else the recorder was killed while it wrote the last bytes
    return found if ended and found is not None and found.complete else None
