"""Invariants: what holds of every run, whatever befalls it.

The run ends. It has the content of the undisturbed run, or it is known to be incomplete, to whoever watched it and by
its recording; and what an incomplete recording has is true. What befalls every run now and then, such as late messages,
a process that stops for a moment or a clock that is put right, changes nothing.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from dynpf_formats.recording.digest import StepKey, StepLine, content_digest, steps
from dynpf_formats.recording.doctor import Finding, diagnosis
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.findings import Severity
from dynpf_formats.recording.reader import Recording, load
from dynpf_protocol.codec import decode
from dynpf_protocol.control import Beat, decode_control
from dynpf_protocol.errors import DynpfError, RunError, UsageError
from dynpf_protocol.keys import BEAT, RECORDED, RECORDER, ROUTER, TICK
from dynpf_protocol.messages import Restart
from dynpf_protocol.topics import is_compared

from dynpf_runtime.machines.effects import Ended, Put, Record, Tell
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.replay import replay_node
from dynpf_runtime.replay_hosts import replay_hosts
from dynpf_runtime.simulation.faults import (
    Clock,
    Crash,
    Cut,
    Delay,
    Drop,
    Duplicate,
    Fault,
    Freeze,
    FullDisk,
    Hang,
    PowerLoss,
    Reorder,
    Slow,
    Tear,
)
from dynpf_runtime.simulation.schedule import Care
from dynpf_runtime.simulation.trial import LIMIT_NS, STANDSTILL_NS, Run, Trial, resume

__all__ = ["Reference", "broken", "is_harmless", "reference_of"]

SECOND = 1_000_000_000

_SPINS = 10
"""So often a process may not wake at once again, and do nothing: it would take a processor for itself."""

_Place = tuple[str, str, int]
"""Node, topic and sequence of a message."""


class Reference(NamedTuple):
    """The undisturbed run: its content digest, and the stamps, payloads and steps of which that is made."""

    digest: str
    messages: Mapping[_Place, tuple[int, bytes]]
    steps: Mapping[StepKey, StepLine]


def reference_of(recording: Recording) -> Reference:
    """Return what the recording of an undisturbed run says."""
    messages = {
        (record.node, record.topic, record.sequence): (record.stamp_ns, record.payload)
        for record in recording.messages()
        if is_compared(record.topic)
    }
    return Reference(content_digest(recording), messages, steps(recording))


def is_harmless(fault: Fault, *, kept: bool) -> bool:
    """Return whether a run has to be whole though this befalls it; ``kept`` if who is gone is started again."""
    match fault:
        case Crash() | Freeze() | Hang() | Cut() | Tear() if kept:
            return True
        case Delay() | Reorder() | Duplicate() | Slow() | Clock():
            return True
        case Freeze(_, _, for_ns):
            return 0 < for_ns <= 0.9 * SECOND
        case Hang(_, _, for_ns):
            return 0 < for_ns <= 2 * SECOND
        case Cut(_, _, for_ns):
            return for_ns <= 1.2 * SECOND
    return False


def broken(run: Run, reference: Reference | None, trial: Trial, *, replay: bool) -> list[str]:
    """Return the invariants that a run has broken, as sentences; its recording is executed again if ``replay``.

    Without a ``reference``, which a realtime run lacks, the content is compared with itself alone.
    """
    found = [*_ends(trial)]
    whole, problems = _recording(run, reference, trial, replay=replay)
    found += problems
    if not whole and reference is not None and not trial.asked and _lost_power(trial):
        found += _resumed(run, reference, trial)
    kept = trial.schedule.care is Care.KEPT
    lost = reference is None and _lost_with_two(run, trial)
    harmless = not (trial.exhausted or lost) and all(is_harmless(fault, kept=kept) for fault in trial.schedule.faults)
    if not whole:
        if not _lost_power(trial):  # it was whole then
            found += _called_whole(trial)
        if harmless:
            found.append("the run is not whole, though nothing befell it that could harm it")
    elif harmless:
        if nodes := [name for name in trial.waited if name in run.plan.graph.nodes and _may_know(name, trial)]:
            found.append(f"the run is whole, and {', '.join(nodes)} had to be killed in the end")
        found += [
            f"the run is whole, and {name} ends: {error}"
            for name, error in trial.simulation.ended.items()
            if error is not None and not (trial.failure == "" and isinstance(error, KeyboardInterrupt))
        ]
    return found


def _lost_with_two(run: Run, trial: Trial) -> bool:
    """Return whether a realtime run lacks what a node did just before it was killed, and the recorder or router, too.

    Then others have read of steps that no journal has, and the node says that it cannot come back.
    """
    struck = {
        RECORDER if isinstance(fault, Tear) else fault.process
        for fault in trial.schedule.faults
        if isinstance(fault, Crash | Freeze | Hang | Cut | Tear)
    }
    nodes = {
        name for name in struck & {*run.plan.graph.nodes} if "cannot come back" in str(trial.simulation.ended.get(name))
    }
    return bool(nodes) and not struck.isdisjoint((RECORDER, ROUTER))


def _ends(trial: Trial) -> Iterator[str]:
    """Yield how a run has not ended as it should."""
    simulation = trial.simulation
    if trial.hung:
        left = [name for name, process in simulation.processes.items() if process.alive]
        yield f"the run hangs: after {LIMIT_NS // SECOND} s {', '.join(left)} still wait"
    elif trial.asked and not _told(trial):
        yield "the run stood still, and nobody said why"
    elif trial.asked and _began(trial) and not _may_stand_still(trial):
        yield f"the run stood still for {STANDSTILL_NS // SECOND} s"
    for name, process in simulation.processes.items():
        if process.most_idle_wakes >= _SPINS:
            yield f"{name} spins: it wakes {process.most_idle_wakes} times in a row, and does nothing"
    for name, error in simulation.ended.items():
        if not isinstance(error, DynpfError | KeyboardInterrupt | RecordingError | None):
            yield f"{name} raised {type(error).__name__}: {error}"


def _began(trial: Trial) -> bool:
    """Return whether anybody has heard that the run has begun; before, it waits for a process that is not there."""
    return any(type(what) is Arrived and what.key.startswith(TICK) for _, _, what in trial.simulation.story)


def _may_stand_still(trial: Trial) -> bool:
    """Return whether a message was lost that a step waits for, or a process hangs and nobody watches it."""
    hangs = any(process.hangs for process in trial.simulation.processes.values())
    return hangs or _dropped(trial)


def _dropped(trial: Trial) -> bool:
    return any(type(fault) is Drop for fault in trial.schedule.faults)


def _told(trial: Trial) -> bool:
    """Return whether a process has said something since the last step of any."""
    for _, _, what in reversed(trial.simulation.story):
        if type(what) is Tell or (type(what) is Ended and what.error is not None):
            return True
        if type(what) is Put and what.key.startswith(TICK):
            return False
    return False


def _may_know(name: str, trial: Trial) -> bool:
    """Return whether a node may know that the run is over: not if the recorder last said so before the node started."""
    said = [
        at_ns
        for at_ns, process, what in trial.simulation.story
        if process == RECORDER and isinstance(what, Put) and what.key == RECORDED
    ]
    return not said or said[-1] > trial.simulation.processes[name].began_ns


def _called_whole(trial: Trial) -> Iterator[str]:
    """Yield who says of a run that is not whole that it is."""
    ended = trial.simulation.ended
    for name in (RECORDER, ROUTER):
        if name in ended and ended[name] is None:
            yield f"the {name} says that the run is whole, and it is not"
    if trial.failure == "":
        yield "dynpf run says that the run is whole, and it is not"


def _recording(run: Run, reference: Reference | None, trial: Trial, *, replay: bool) -> tuple[bool, list[str]]:
    """Return whether the recording is that of a whole run, and what is wrong with it that it does not say."""
    path = trial.path
    if not path.exists():
        return False, []
    spoilt = any(isinstance(fault, PowerLoss | Tear | FullDisk) for fault in trial.schedule.faults)
    found = []
    try:
        recording, damage = load(path)
    except RecordingError as error:
        return False, [] if spoilt else [f"the recording cannot be read: {error}"]
    diagnosed = diagnosis(recording, damage)
    errors = [item.what for item in diagnosed.findings if item.severity is not Severity.WARNING]
    whole = not errors
    if whole and (recording.end is None or not recording.end.complete):
        found.append("the recording says that it is not whole, and the doctor finds nothing")
    if not damage and recording.end is not None:
        found += _says(recording, errors, diagnosed.altered)
        if whole and recording.end.missing and not _dropped(trial):
            found.append(f"{recording.end.missing} messages that are not compared are missing, and none was dropped")
    if whole and reference is not None and not trial.asked and content_digest(recording) != reference.digest:
        found.append("the recording is called whole, and has not the content of the undisturbed run")
    if not whole and reference is not None and not damage:
        found += _untrue(recording, reference)
    if not damage and not _lacks(recording, trial) and replay:
        found += _replayed(run, recording)
    return whole, found


def _lacks(recording: Recording, trial: Trial) -> bool:
    """Return whether a recording says that it lacks a message: after the last of a topic that is no gap in numbers."""
    end = recording.end
    return end is not None and bool(end.missing or (end.unresolved and _dropped(trial)))


def _says(recording: Recording, errors: list[str], altered: Iterable[Finding]) -> Iterator[str]:
    """Yield what the end of a recording says and what is not so."""
    assert recording.end is not None
    if recording.end.complete and errors:
        yield f"the recording is called whole, and the doctor finds: {errors[0]}"
    if not recording.end.complete and not recording.end.reason:
        yield "the recording is not whole, and does not say why"
    if not recording.end.missing and not recording.end.unresolved:  # else the chain of digests has to break
        for item in altered:
            yield f"the recording says what is not so: {item.where}: {item.what}"
            return


def _untrue(recording: Recording, reference: Reference) -> Iterator[str]:
    """Yield the first message and the first step that the undisturbed run does not have."""
    for record in recording.messages():
        if is_compared(record.topic):
            expected = reference.messages.get((record.node, record.topic, record.sequence))
            if expected != (record.stamp_ns, record.payload):
                yield f"{record.topic} {record.sequence} of {record.node} is not that of the undisturbed run"
                break
    for key, line in steps(recording).items():
        expected_line = reference.steps.get(key._replace(number=line.step))
        if expected_line is None or line._replace(state=expected_line.state) != expected_line:
            yield f"step {line.step} of {key.node} is not that of the undisturbed run"
            break


def _lost_power(trial: Trial) -> bool:
    return any(type(fault) is PowerLoss for fault in trial.schedule.faults)


def _resumed(run: Run, reference: Reference, trial: Trial) -> Iterator[str]:
    """Yield what is wrong with a run that has lost power and is resumed, or with what the disk has kept of it."""
    confirmed = _confirmed(trial) if run.durable else 0
    if not trial.path.exists():
        return
    try:
        again = resume(run, trial)
    except RecordingError as error:
        if confirmed:
            yield f"the recorder had confirmed {confirmed} ticks, and nothing can be read: {error}"
        return
    yield from _ends(again)
    told = [line for what in again.simulation.story if isinstance(what.what, Record) for line in _restart(what.what)]
    if told and told[-1].tick < confirmed:  # the restarts before it are among what was recorded
        yield f"the recorder had confirmed {confirmed} ticks, and {told[-1].tick} can be read after the loss of power"
    ended = again.simulation.ended.get(RECORDER, RunError("it has not ended"))
    if ended is not None:
        yield f"the run cannot be resumed: {ended}"
    elif content_digest(load(again.path)[0]) != reference.digest:
        yield "the resumed run has not the content of the undisturbed one"


def _confirmed(trial: Trial) -> int:
    """Return how many ticks the recorder has said to have in its file."""
    beats = [
        min(decode_control(what.payload, Beat).kept.values(), default=0)
        for _, name, what in trial.simulation.story
        if type(what) is Put and name == RECORDER and what.key == BEAT + RECORDER
    ]
    return max(beats, default=0)


def _restart(record: Record) -> Iterator[Restart]:
    """Yield what a record says of a recorder that has gone on with the file of another."""
    if record.topic == "recorder/restart":
        restart = decode(record.topic, record.payload)
        assert isinstance(restart, Restart)
        if restart.node == RECORDER:
            yield restart


def _replayed(run: Run, recording: Recording) -> Iterator[str]:
    """Yield where a replay of what was recorded differs from it."""
    for mismatch in replay_hosts(recording, run.plan):
        yield f"a replay of the hosts differs: {mismatch}"
        break
    for name in run.plan.graph.nodes:
        try:
            outcome = replay_node(recording, run.plan, name)
        except UsageError:  # it says that the recording lacks what the step has read, and what
            continue
        if outcome.mismatch is not None:
            yield f"a replay of {name} differs: {outcome.mismatch}"
