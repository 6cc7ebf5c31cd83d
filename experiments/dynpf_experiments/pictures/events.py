"""What happened in a run besides its estimates: gaps, faults, warnings, processes that came back, and the end."""

from dynpf_formats.recording.info import ended
from dynpf_protocol.messages import Gap, HostEvent, Log, LogLevel
from dynpf_protocol.printable import printable
from dynpf_protocol.topics import TOPICS, is_act

from dynpf_experiments.pictures.disturbances import leaps, silences
from dynpf_experiments.pictures.event import Event, act_in_words
from dynpf_experiments.pictures.source import RunSource

__all__ = ["events_of", "faults_of"]

MOST_EVENTS = 200
MOST_TOLD = 2000
"""Messages of a topic that are looked through."""

ACTS_S = 1.0
_ACT_TYPES = tuple(row.type for name, row in TOPICS.items() if is_act(name))


def events_of(source: RunSource) -> tuple[list[Event], int]:
    """Return the events of a run in order of time, at most MOST_EVENTS, and how many there are in all."""
    found = [*_gaps(source), *_logs(source), *_restarts(source), *_acts(source), *silences(source), *leaps(source)]
    found.sort(key=lambda event: event.seconds)
    return [*found[: MOST_EVENTS - 1], _end(source)], len(found) + 1


def faults_of(source: RunSource) -> list[str]:
    """Return the faults that the run's scenario injects, a sentence each."""
    faults = () if source.scenario is None else source.scenario.faults
    texts = []
    for fault in faults[:MOST_EVENTS]:
        late = (
            f", {fault.delay_s:g} to {fault.delay_s + fault.jitter_s:g} s late"
            if fault.delay_s or fault.jitter_s
            else ""
        )
        texts.append(f"{printable(fault.topic)} to {printable(fault.to)}: {100.0 * fault.loss:g} % lost{late}")
    return texts


def _gaps(source: RunSource) -> list[Event]:
    found = []
    for topic in source.carrying(Gap, HostEvent):
        for at, message in source.messages(topic, MOST_TOLD):
            match message:
                case Gap():
                    told, node = "never reached the recorder", "recorder"
                case HostEvent():
                    told, node = "never reached it", topic.partition("/")[2]
                case _:
                    continue
            which = f"{message.first}" if message.first == message.last else f"{message.first} to {message.last}"
            text = f"{printable(message.topic)} {which} of {printable(message.node)} {told}"
            found.append(Event(at, "gap", "warning", node, text))
    return found


def _logs(source: RunSource) -> list[Event]:
    levels = {LogLevel.INFO: "info", LogLevel.WARNING: "warning", LogLevel.ERROR: "error", LogLevel.FATAL: "error"}
    return [
        Event(at, "log", levels[message.level], printable(message.name), printable(message.message))
        for topic in source.carrying(Log)
        for at, message in source.messages(topic, MOST_TOLD)
        if isinstance(message, Log) and message.level in levels
    ]


def _acts(source: RunSource) -> list[Event]:
    """Return what a person did to the world; of acts that follow each other closely, as in driving, the first."""
    found = []
    for topic in source.carrying(*_ACT_TYPES):
        before = -ACTS_S
        for at, message in source.messages(topic, MOST_TOLD) if is_act(topic) else ():
            if at - before >= ACTS_S:
                found.append(Event(at, "act", "info", "operator", act_in_words(topic, message)))
            before = at
    return found


def _restarts(source: RunSource) -> list[Event]:
    recording = source.recording
    found = []
    for node in dict.fromkeys(each.node for each in recording.sources):
        for boot in recording.boots(node)[1:MOST_EVENTS]:
            of_boot = [recording.of(each) for each in recording.sources if (each.node, each.boot) == (node, boot)]
            stamps = [records[0].stamp_ns for records in of_boot if len(records)]
            at = (min(stamps, default=source.origin_ns) - source.origin_ns) * 1e-9
            found.append(Event(at, "restart", "warning", printable(node), "started again"))
    return found


def _end(source: RunSource) -> Event:
    begin, last = source.span_ns
    at, end = (last - begin) * 1e-9, source.recording.end
    if end is None:
        return Event(at, "end", "error", "recorder", "the end of the run was never written")
    text = printable(ended(end.reason, end.outcome))
    return Event(at, "end", "info" if end.complete else "error", "recorder", text or "ended")
