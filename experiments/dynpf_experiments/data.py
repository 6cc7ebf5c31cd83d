"""The folder of data that studies read logs from."""

import os
from pathlib import Path

from dynpf_protocol.errors import UsageError

__all__ = ["FOLDER_VARIABLE", "data_path"]

FOLDER_VARIABLE = "DYNPF_DATA"
"""The environment variable that names the folder."""


def data_path(name: str, below: str, instead: str) -> Path:
    """Return the path of the log ``name`` in the folder of data; ``instead`` tells the user what to do without it.

    Raises UsageError where no folder is named, or it has no such file.
    """
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        raise UsageError(
            f"{name} is read from a folder of data: name it by --data FOLDER or {FOLDER_VARIABLE}; {instead}"
        )
    path = Path(folder) / below
    if not path.exists():
        raise UsageError(f"{name} is read from {path}, which is not there; {instead}")
    return path
