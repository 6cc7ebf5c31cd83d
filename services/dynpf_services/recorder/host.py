"""The recorder process: the recorder's machine on the bus, and its file."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from dynpf_formats.recording.header import Attachment, RunEnd
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.keys import RECORDER
from dynpf_runtime.bus.edge import drive, new_boot
from dynpf_runtime.bus.keys import Credentials
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.effects import Close, Effect, Flush, Open, Record, Show
from dynpf_runtime.machines.events import Closed
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.plan import Plan, run_header
from dynpf_runtime.progress import Progress

__all__ = ["RecorderFile", "run_recorder"]


def run_recorder(
    plan: Plan,
    endpoint: str,
    path: Path,
    attachments: tuple[Attachment, ...],
    stop: StopSignal,
    *,
    pulse: Pulse,
    keys: Credentials | None = None,
) -> RunEnd:
    """Record one run into ``path`` and return how it ended.

    Raises RunError if the run broke off, after closing the recording and marking it incomplete, and RecordingError if
    the file cannot be written.
    """
    boot = new_boot()
    name = os.fsencode(path).decode(errors="backslashreplace")  # it travels, and need not be UTF-8
    machine = RecorderMachine(plan, boot, endpoint, name)
    with (
        Bus.connect(endpoint, lambda text: say(RECORDER, text), lambda: stop.requested, keys) as bus,
        RecorderFile(plan, boot, path, attachments) as file,
    ):
        drive(RECORDER, machine, bus, stop, file.perform, pulse=pulse)
    assert file.end is not None, "the machine has ended without an error and without a recording"
    return file.end


class RecorderFile:
    """Carries out the effects of a recorder's machine on the file: opens, writes and closes the recording.

    If an error leaves the context while the file is open, the recording's end names the error.
    """

    def __init__(
        self,
        plan: Plan,
        boot: str,
        path: Path,
        attachments: Sequence[Attachment] = (),
        open_writer: Callable[..., RecordingWriter] = RecordingWriter,
    ) -> None:
        self.end: RunEnd | None = None
        self._open_writer = open_writer
        self._plan, self._boot, self._path, self._attachments = plan, boot, path, tuple(attachments)
        self._writer: RecordingWriter | None = None
        self._progress = Progress()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if self._writer is not None and self.end is None:
            self._progress.clear()
            self._writer.close(complete=False, reason=f"ended by {kind.__name__}: {error}" if kind else "never closed")

    def perform(self, effect: Effect) -> Closed | None:
        """Carry out an effect; raises RecordingError."""
        match effect:
            case Record():
                self._open.message(*effect)
            case Open():
                self._writer = self._open_writer(
                    self._path,
                    run_header(self._plan),
                    self._attachments,
                    boot=self._boot,
                    topics=self._plan.graph.topics,
                )
            case Flush(now_ns):
                self._open.flush_if_due(now_ns)
            case Show(ticks, messages):
                self._progress.show(ticks, messages)
            case Close(complete, reason, outcome):
                self._progress.clear()
                self.end = self._open.close(complete=complete, reason=reason, outcome=outcome)
                return Closed(self.end)
            case _:
                raise TypeError(f"a recorder's file does not carry out {effect!r}")
        return None

    @property
    def _open(self) -> RecordingWriter:
        assert self._writer is not None, "the recording is not open"
        return self._writer
