"""The temporary folder of a run: nobody else may read it, and it does not outlive the processes of the run."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from dynpf_protocol.errors import UsageError
from dynpf_protocol.json_text import read_json

try:
    import fcntl
except ImportError:  # not on this system; folders of killed runs then stay
    fcntl = None  # type: ignore[assignment]

__all__ = ["GUEST_KEYS", "SCENARIO_FILE", "Place", "read_place", "run_folder", "write_place"]

_PREFIX = "dynpf-"
_LOCK = "in-use"
_PLACE = "run.json"

SCENARIO_FILE = "scenario.json"
"""The resolved scenario, with the content of its files."""

GUEST_KEYS = "guests"
"""The keys of an observer and an operator, unless the run has put them elsewhere."""


class Place(msgspec.Struct, frozen=True):
    """Where a run can be found: its router, and the recording that is being written."""

    endpoint: str
    recording: str


def write_place(folder: Path, endpoint: str, recording: Path) -> None:
    """Write where the run of a folder can be found."""
    name = os.fsencode(recording.absolute()).decode(errors="backslashreplace")
    (folder / _PLACE).write_bytes(msgspec.json.encode(Place(endpoint, name)))


def read_place(folder: Path) -> Place:
    """Return where the run of a folder can be found; raises UsageError."""
    try:
        return read_json((folder / _PLACE).read_bytes(), Place)
    except (OSError, msgspec.DecodeError) as error:
        why = f"{_PLACE}: {error.strerror.lower()}" if isinstance(error, OSError) and error.strerror else str(error)
        raise UsageError(
            f"{folder}: is not the folder of a run that goes on ({why}); dynpf run names its own when it begins"
        ) from error


@contextmanager
def run_folder() -> Iterator[Path]:
    """Make a folder of mode 0700, which is removed when the block ends.

    It holds a locked file, which processes forked from this one keep locked, too. Folders whose file is no longer
    locked, because all processes of their run were killed, are removed first.
    """
    if fcntl is not None:
        _remove_abandoned(Path(tempfile.gettempdir()))
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as name:
        folder = Path(name)
        if fcntl is None:
            yield folder
            return
        with (folder / "new").open("wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            (folder / "new").rename(folder / _LOCK)  # no one sees the file unlocked
            yield folder


def _remove_abandoned(parent: Path) -> None:
    """Remove this user's folders of runs that are over, or were killed with all their processes."""
    for path in parent.glob(f"{_PREFIX}*/{_LOCK}"):
        with contextlib.suppress(OSError):
            if path.parent.lstat().st_uid != os.getuid() or path.parent.is_symlink():
                continue
            descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises while the run lasts
                shutil.rmtree(path.parent, ignore_errors=True)
            finally:
                os.close(descriptor)
