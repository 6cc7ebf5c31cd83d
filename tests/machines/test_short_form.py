"""The references come out the same under settings that choose other kernels: the short form of `make test-machines`."""

from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.references.table import read_table

from checks.machines.jobs import REFERENCE, chosen
from checks.machines.report import row_of
from checks.machines.runs import Outcome, compared, processor, run
from checks.machines.settings import DEFAULT, SHORT, processor_settings

JOBS = [job.name for job in chosen([REFERENCE])]
TABLE = read_table()
ROWS = {entry.name: entry for entry in TABLE.rows}


@pytest.fixture(scope="module")
def default(tmp_path_factory) -> Outcome:
    return run(DEFAULT, [], tmp_path_factory.mktemp("default"))


@pytest.mark.parametrize("name", SHORT)
def test_references_are_the_same_under(name, default, tmp_path):
    setting = {one.name: one for one in processor_settings(processor(default.told))}.get(name)
    if setting is None:
        pytest.skip("this processor has no such choice")
    outcome = run(setting, JOBS, tmp_path)
    assert not outcome.failure
    if not row_of(default, outcome, ()).effective:
        pytest.skip("no effect here: it would prove nothing")
    assert {job: told for job in JOBS if (told := difference(job, outcome))} == {}


def difference(job: str, outcome: Outcome) -> str:
    """Tell what differs from the recording of a reference; empty if nothing does."""
    entry, done = ROWS[job.removeprefix(REFERENCE)], outcome.done[job]
    if done.absent or done.error:
        return done.error
    found = read_recording(outcome.folder / f"{job}.mcap")
    assert entry.made is not None
    if content_digest(found) == entry.made.digest:
        return ""
    recorded: Path = TABLE.recording(entry)
    where = compared(job, read_recording(recorded), found).where if recorded.is_file() else "another content digest"
    return str(where)
