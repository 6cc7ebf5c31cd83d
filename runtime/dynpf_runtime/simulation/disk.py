"""The disk: files in memory, which a kill leaves as they are, and a loss of power only as far as they were synced."""

import errno
import os
from pathlib import Path
from random import Random

from dynpf_runtime.simulation.process import Killed

__all__ = ["BLOCK", "Disk", "SimulatedFile"]

BLOCK = 4096
"""What a disk writes at once, bytes: after a loss of power each block is there, old, or torn."""


class Disk:
    """Files by path. ``room`` is how many bytes there is room for, None for any number.

    ``tears`` has the writes, by their number from 0, in the midst of which the process is killed, and how many parts in
    256 of them are written.
    """

    def __init__(self) -> None:
        self.files: dict[Path, SimulatedFile] = {}
        self.room: int | None = None
        self.writes = 0
        self.tears: dict[int, int] = {}

    def open(self, path: Path, overwrite: bool) -> "SimulatedFile":
        """Create a file; raises FileExistsError if it exists and may not be replaced."""
        if path in self.files and not overwrite:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        file = self.files[path] = SimulatedFile(self)
        return file

    def lose_power(self, draw: int) -> None:
        """Keep of each file what was synced, and of what was not, whatever the disk had come to write: any blocks."""
        random = Random(draw)
        for file in self.files.values():
            file.lose_power(random)

    @property
    def used(self) -> int:
        """Bytes in all files."""
        return sum(len(file.data) for file in self.files.values())


class SimulatedFile:
    """A file that is written from its beginning to its end."""

    def __init__(self, disk: Disk) -> None:
        self.data = bytearray()
        self._disk = disk
        self._synced = 0

    def write(self, data: bytes) -> int:
        """Write all of ``data``; raises OSError for lack of room, after what there was room for, and Killed."""
        disk = self._disk
        number, disk.writes = disk.writes, disk.writes + 1
        if (kept := disk.tears.get(number)) is not None:
            self.data += data[: len(data) * kept // 256]
            raise Killed
        room = len(data) if disk.room is None else max(0, disk.room - disk.used)
        self.data += data[:room]
        if room < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return len(self.data)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        """Have everything written to the disk."""
        self._synced = len(self.data)

    def close(self) -> None:
        """Do nothing: what was written stays."""

    def lose_power(self, random: Random) -> None:
        """Keep what was synced, and of each block after that all, nothing, or a part of it."""
        end = self._synced + random.randint(0, len(self.data) - self._synced)
        for start in range(self._synced - self._synced % BLOCK, end, BLOCK):
            first, last = max(start, self._synced), min(start + BLOCK, end)
            kept = random.choice((last - first, 0, random.randint(0, last - first)))
            self.data[first + kept : last] = bytes(last - first - kept)
        del self.data[end:]
