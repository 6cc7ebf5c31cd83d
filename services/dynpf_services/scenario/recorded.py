"""What of a scenario travels in a recording beside its text, and how a scenario comes out of a recording again."""

import errno
from collections.abc import Container, Iterable, Sequence
from pathlib import Path

import msgspec
from dynpf_formats.recording.attachments import FOLDER, attached, is_file
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.reader import Recording

from dynpf_services.scenario.files import with_files
from dynpf_services.scenario.load import override_resolved, with_user_code
from dynpf_services.scenario.schema import File, Scenario

__all__ = ["attachments_of", "recorded_scenario"]


def attachments_of(scenario: Scenario, others: Iterable[Attachment] = ()) -> tuple[Attachment, ...]:
    """Return what a recording of ``scenario`` has attached: the files that it names, and ``others``."""
    named = [attached(name, file.data) for name, file in sorted(scenario.files.items())]
    return (*(one for one in others if not is_file(one)), *named)


def recorded_scenario(recording: Recording, overrides: Sequence[str] = (), allow_code: Container[str] = ()) -> Scenario:
    """Return the scenario of a recording, ready to be run again.

    Files are the recording's attachments, whatever their paths say; of the disk only those are opened that
    ``overrides`` name, and the images of such maps. Of the user's modules, those that ``allow_code`` names have the
    digests in it that they have here and now; the others cannot be imported.

    Raises ScenarioError for an override that does not fit, for a file that did not come along, and for an allowed
    module that is not there.
    """
    where, text = str(recording.path), recording.header.scenario
    recorded = override_resolved(text, (), where)
    scenario = override_resolved(text, overrides, where) if overrides else recorded
    wished = {*scenario.paths} - {*recorded.paths}
    contents = {one.name.removeprefix(FOLDER): one.data for one in recording.attachments if is_file(one)}

    def read(path: str, named: str) -> bytes:
        if named in wished and named not in contents:
            return Path(path).read_bytes()
        raise FileNotFoundError(errno.ENOENT, "the recording has no such file attached")

    files = {name: File(sha256="", data=data) for name, data in contents.items()}
    scenario = with_user_code(msgspec.structs.replace(scenario, files=files), where, allow_code)
    return with_files(scenario, where, read)
