"""Scenarios in recordings: the attached files, and restoring a scenario from a recording."""

import errno
from collections.abc import Container, Iterable, Sequence

import msgspec
from dynpf_formats.recording.attachments import attached, changed_files, files_of, is_file
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.reader import Recording
from dynpf_formats.regular_files import read_regular
from dynpf_protocol.errors import ScenarioError

from dynpf_services.scenario.files import with_files
from dynpf_services.scenario.load import override_resolved, with_user_code
from dynpf_services.scenario.schema import File, Scenario

__all__ = ["attachments_of", "described_scenario", "recorded_scenario"]


def attachments_of(scenario: Scenario, others: Iterable[Attachment] = ()) -> tuple[Attachment, ...]:
    """Return the attachments of a recording of ``scenario``: the files that it names, and ``others``."""
    named = [attached(name, file.data) for name, file in sorted(scenario.files.items())]
    return (*(attachment for attachment in others if not is_file(attachment)), *named)


def recorded_scenario(recording: Recording, overrides: Sequence[str] = (), allow_code: Container[str] = ()) -> Scenario:
    """Return the scenario of a recording, ready to run again; see ``described_scenario``."""
    text = recording.header.scenario
    return described_scenario(text, recording.attachments, str(recording.path), overrides, allow_code)


def described_scenario(
    text: str,
    attachments: Iterable[Attachment],
    where: str,
    overrides: Sequence[str] = (),
    allow_code: Container[str] = (),
) -> Scenario:
    """Return the scenario that a resolved text and the attachments of a recording describe, ready to run again.

    Its files are attachments, whatever their paths; only files that ``overrides`` name, and the images of such maps,
    are read from disk. User modules that ``allow_code`` names get their present digests; others cannot be imported.

    Raises ScenarioError naming ``where`` for an override that does not fit, for a file that is not attached or not the
    run's, and for an allowed module that does not exist.
    """
    attachments = tuple(attachments)
    if changed := changed_files(text, attachments):
        raise ScenarioError("\n".join(f"{where}: {line}" for line in changed))
    recorded = override_resolved(text, (), where)
    scenario = override_resolved(text, overrides, where) if overrides else recorded
    overridden = {*scenario.paths} - {*recorded.paths}
    contents = files_of(attachments)

    def read(path: str, named: str) -> bytes:
        if named in overridden and named not in contents:
            return read_regular(path)
        raise FileNotFoundError(errno.ENOENT, "the recording has no such file attached")

    files = {name: File(sha256="", data=data) for name, data in contents.items()}
    scenario = with_user_code(msgspec.structs.replace(scenario, files=files), where, allow_code)
    return with_files(scenario, where, read)
