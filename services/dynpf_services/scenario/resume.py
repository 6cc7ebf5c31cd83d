"""Resumes a lockstep run that was stopped or killed: what its recording allows, and how it goes on in one process.

On the bus the recorder takes the run over from its recording, and tells the nodes what they had done before
(``dynpf service recorder --resume``). In one process the same ledger reads the recording.
"""

from collections.abc import Callable, Container, Mapping
from pathlib import Path

from dynpf_formats.recording.reader import Recording, load
from dynpf_formats.recording.signature import signature_file
from dynpf_formats.regular_files import exists, is_claimed
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import UsageError
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.keys import RECORDER
from dynpf_protocol.messages import Restart
from dynpf_protocol.topics import LOG_NODE
from dynpf_runtime.branch import brought
from dynpf_runtime.bus.edge import new_boot
from dynpf_runtime.inline import Begun, run_inline
from dynpf_runtime.machines.effects import Close, Open, Record
from dynpf_runtime.machines.events import Found
from dynpf_runtime.machines.ledger import Ledger
from dynpf_runtime.machines.rebuilding import rebuilt
from dynpf_runtime.machines.roles import Roles
from dynpf_runtime.seat import Seat

from dynpf_services.recorder.host import RecorderFile, recorded_boots
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.played_log import PlayedLog, acts_of
from dynpf_services.scenario.record import check_log
from dynpf_services.scenario.recorded import attachments_of
from dynpf_services.scenario.replay import changed_code, scenario_of_replay
from dynpf_services.scenario.schema import Scenario

__all__ = ["resumable", "resume_inline"]

RESTART = "recorder/restart"


def resumable(path: Path, log: PlayedLog | None, allow_code: Container[str]) -> Scenario:
    """Return the scenario of the run that a recording has begun, ready to go on.

    Raises UsageError, with a sentence, for a run that cannot go on; RecordingError for what is no recording, and
    ScenarioError for code that is not allowed.
    """
    recording, damage = load(path)
    end = recording.end
    if end is not None and end.complete and not damage and not end.stopped:
        raise UsageError(f"{path}: the run is whole ({end.reason}): there is nothing to resume")
    if is_claimed(path):
        raise UsageError(f"{path}: a recorder is still writing it: the run goes on, and cannot be resumed")
    if recording.header.clock != "lockstep":
        raise UsageError(
            f"{path}: a realtime run goes by the wall clock, and what its nodes would have been told meanwhile is "
            "lost: only a lockstep run can be resumed; dynpf recover mends the file"
        )
    if exists(signature_file(path)):
        raise UsageError(f"{signature_file(path)}: signs the recording as it is; move it away to resume the run")
    scenario = scenario_of_replay(recording, allow_code=allow_code)
    for module, then, digest in changed_code(recording, scenario):
        raise UsageError(
            f"{path}: the module {module} has changed since the run began: its source is {digest[:12]}, and was "
            f"{then[:12]}; the run can only go on with the same code"
        )
    check_log(scenario, None if log is None else log.path)
    _check_same(recording, scenario, log)
    return scenario


def _check_same(recording: Recording, scenario: Scenario, log: PlayedLog | None) -> None:
    """Raise UsageError if the run would be another one."""
    if log is not None and scenario.log_digest != log.facts.digest:
        raise UsageError(f"--log {log.path}: is not the log that the run of {recording.path} has played")
    if plan_of(scenario).text != recording.header.scenario:
        raise UsageError(f"{recording.path}: this dynpf reads its scenario otherwise: the run cannot go on here")


class _Rest:
    """What goes into a recording, its recorder's ``file``: all but what is of the steps that it has ``written``."""

    def __init__(self, file: RecorderFile, written: Mapping[str, int], source: str) -> None:
        self.messages = 0
        self._file, self._written, self._source = file, written, source

    def message(self, topic: str, envelope: Envelope, payload: bytes) -> None:
        """Write a message, unless its step is recorded."""
        sender = self._source if envelope.node == LOG_NODE else envelope.node
        if envelope.tick >= self._written[sender]:
            self.messages += 1
            self._file.perform(Record(topic, envelope, payload))

    def journal(self, envelope: Envelope, payload: bytes) -> None:
        """Write a journal entry, unless it is recorded."""
        if envelope.tick >= self._written[envelope.node]:
            self._file.perform(Record(JOURNAL_PREFIX + envelope.node, envelope, payload))


class _Stop:
    """Whether the next tick of a resumed run is its last: by the user, after all recorded ticks."""

    def __init__(self, tick: int, recorded: int, stopped: Callable[[], str]) -> None:
        self._tick, self._recorded, self._stopped = tick, recorded, stopped

    def next(self) -> bool:
        """Return whether the next tick is the last."""
        tick, self._tick = self._tick, self._tick + 1
        return tick >= self._recorded and bool(self._stopped())


def resume_inline(
    path: Path,
    scenario: Scenario,
    log: PlayedLog | None,
    *,
    stopped: Callable[[], str] = lambda: "",
    durable: bool = False,
) -> int:
    """Go on with the run of a recording to its end, in this process, and return the tick from which it went on.

    The whole steps of the recording are written into a draft beside it, which takes its place before the run goes on.
    Raises RunError if the nodes do not do again what they did.
    """
    plan = plan_of(scenario)
    graph, boots, start = plan.graph, recorded_boots(path, plan), new_boot()
    attachments = attachments_of(scenario, () if log is None else log.attachments)
    with RecorderFile(plan, start, path, attachments, durable=durable) as file:
        ledger = Ledger(plan, Roles(plan, boots))
        found = file.perform(Open(again=True, anew=True))
        assert isinstance(found, Found), "a whole recording is not resumed"
        for effect in rebuilt(found.messages, ledger, graph.topics, boots, {}, anew=True):
            file.perform(effect)
        written = {name: ledger.place(name).written for name in graph.nodes}
        tick = ledger.ticks
        told = Restart(node=RECORDER, before=boots[RECORDER], start=start, tick=tick, absent_s=0.0)
        envelope = Envelope(RECORDER, start, 0, tick, ledger.stamp_ns, 0)
        file.perform(Record(RESTART, envelope, encode(RESTART, told)))
        recording, _ = load(path)
        first = {name: Seat(spec, plan, boots[name]) for name, spec in graph.specs.items()}
        begun = brought(recording, plan, tick) if tick else Begun(0, first)
        stop = _Stop(tick, max(written.values()), stopped)
        rest = _Rest(file, written, graph.source)
        records, acts = () if log is None else log.records, acts_of(recording)
        ran = run_inline(plan, records, rest, stopped=stop.next, begun=begun, acts=acts)
        file.perform(Close(True, stopped() or "finished", ran.outcome))
    return tick
