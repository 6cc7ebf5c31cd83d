"""The disk: files that a kill leaves as they are, and a loss of power only as far as they were synced.

They are real files, in a folder in memory, so that whatever reads or moves recordings finds them there.
"""

import errno
import os
from pathlib import Path
from random import Random

from dynpf_runtime.simulation.process import Killed

__all__ = ["BLOCK", "Disk", "SimulatedFile"]

BLOCK = 4096
"""What a disk writes at once, bytes: after a loss of power each block is there, missing, or torn."""


class Disk:
    """The files in ``folder``; those that are there are ``kept`` or removed.

    ``room`` is how many bytes there is room for, None for any number. ``tears`` has the writes, by their number from 0,
    in the midst of which the process is killed, and how many parts in 256 of them are written.
    """

    def __init__(self, folder: Path, *, kept: bool = False) -> None:
        self.folder = folder
        self.room: int | None = None
        self.writes = 0
        self.tears: dict[int, int] = {}
        self._files: list[SimulatedFile] = []
        for path in () if kept else folder.iterdir():
            path.unlink()

    def open(self, path: Path, overwrite: bool) -> "SimulatedFile":
        """Create a file; raises FileExistsError if it exists and may not be replaced."""
        file = SimulatedFile(self, path, overwrite)
        for other in [other for other in self._files if other.same_as(file)]:  # what a killed process had begun there
            other.raw.close()
            self._files.remove(other)
        self._files.append(file)
        return file

    def lose_power(self, draw: int) -> None:
        """Keep of each file what was synced, and of what was not, whatever the disk had come to write: any blocks."""
        random = Random(draw)
        for file in self._files:
            file.lose_power(random)

    def close(self) -> None:
        """Close all files."""
        for file in self._files:
            file.raw.close()

    @property
    def used(self) -> int:
        """Bytes in all files."""
        return sum(file.tell() for file in self._files)


class SimulatedFile:
    """A file that is written from its beginning to its end; who closes it only says so."""

    def __init__(self, disk: Disk, path: Path, overwrite: bool) -> None:
        self.raw = path.open("w+b" if overwrite else "x+b", buffering=0)
        self._disk = disk
        self._size = self._synced = 0

    def same_as(self, other: "SimulatedFile") -> bool:
        """Return whether both are one file, which the later one has emptied."""
        return os.path.samestat(os.fstat(self.raw.fileno()), os.fstat(other.raw.fileno()))

    def write(self, data: bytes) -> int:
        """Write all of ``data``; raises OSError for lack of room, after what there was room for, and Killed."""
        disk = self._disk
        number, disk.writes = disk.writes, disk.writes + 1
        if (kept := disk.tears.get(number)) is not None:
            self._put(data[: len(data) * kept // 256])
            raise Killed
        room = len(data) if disk.room is None else max(0, disk.room - disk.used)
        self._put(data[:room])
        if room < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return len(data)

    def _put(self, data: bytes) -> None:
        self._size += self.raw.write(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._size

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        """Have everything written to the disk."""
        self._synced = self._size

    def close(self) -> None:
        """Do nothing: the disk closes its files when the trial is over."""

    def lose_power(self, random: Random) -> None:
        """Keep what was synced, and of each block after that all, nothing, or a part of it."""
        end = self._synced + random.randint(0, self._size - self._synced)
        for start in range(self._synced - self._synced % BLOCK, end, BLOCK):
            first, last = max(start, self._synced), min(start + BLOCK, end)
            kept = random.choice((last - first, 0, random.randint(0, last - first)))
            os.pwrite(self.raw.fileno(), bytes(last - first - kept), first + kept)
        self.raw.truncate(end)
        self._size = end
