"""Simulates the runs of a scenario, with all their processes, under schedules of faults."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_runtime.plan import Plan
from dynpf_runtime.simulation.campaign import Campaign, scratch
from dynpf_runtime.simulation.invariants import reference_of
from dynpf_runtime.simulation.memory import Memory, remembering
from dynpf_runtime.simulation.trial import Run

from dynpf_services.recorder.host import RecorderFile, recorded_boots
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.record import Log, LogContent, record_inline
from dynpf_services.scenario.recorded import attachments_of
from dynpf_services.scenario.schema import Scenario

__all__ = ["campaign_of"]


@contextmanager
def campaign_of(
    scenario: Scenario, seed: int, log: Log | None = None, *, memory: bool = True, durable: bool = False
) -> Iterator[Campaign]:
    """Have the campaign of a scenario under a seed, for as long as the block lasts.

    With ``memory`` a node is executed only on what it has not been given in another trial; a ``durable`` recording is
    synced before it is confirmed.
    """
    log = log or LogContent()
    records = list(log.records)
    attachments = attachments_of(scenario, log.attachments)
    plan = plan_of(scenario)
    if memory:
        plan = remembering(plan, Memory())

    def opened(plan: Plan, start: str, path: Path, open_writer: Callable[..., RecordingWriter]) -> RecorderFile:
        return RecorderFile(plan, start, path, attachments, open_writer, durable=durable)

    run = Run(plan, records, opened, recorded_boots, durable)
    with scratch() as folder:
        reference = None
        if scenario.clock == "lockstep":
            path = folder / "reference.mcap"
            record_inline(scenario, path, LogContent(records, log.attachments))
            reference = reference_of(read_recording(path))
        disk = folder / "disk"
        disk.mkdir()
        yield Campaign(run, reference, seed, disk)
