"""What a lockstep step was given, by the recording: also of a step that was never made, because its node died of it."""

from collections.abc import Iterator

from dynpf_formats.recording.reader import Recording

from dynpf_runtime.plan import Plan

__all__ = ["given"]


def given(recording: Recording, plan: Plan, node: str, tick: int) -> Iterator[tuple[str, int]]:
    """Yield topic and sequence of the messages that others have sent to the step of a node in a tick."""
    reads = plan.graph.specs[node].reads
    for other, lag in plan.graph.lags[node].items():
        for name, boot in recording.journals():
            if name != other:
                continue
            entries = (entry for entry in recording.journal(name, boot) if entry.tick == tick - lag)
            for entry in entries:
                made = [(one.topic, one.sequence) for one in entry.hosted]
                made += [(one.topic, one.sequence) for one in entry.produced]
                yield from (place for place in made if place[0] in reads)
