"""A simulated disk loses what a real one may lose, and nothing else."""

from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from dynpf_runtime.simulation.disk import BLOCK, Disk
from dynpf_runtime.simulation.process import Killed

SYNCED = bytes(range(1, 256)) * 30
WRITTEN = b"\xff" * (5 * BLOCK)


@pytest.fixture(name="disk")
def a_disk(tmp_path: Path) -> Iterator[Disk]:
    disk = Disk(tmp_path)
    yield disk
    disk.close()


def test_a_loss_of_power_keeps_what_was_synced_and_any_blocks_of_the_rest(disk: Disk) -> None:
    kept = set()
    for draw in range(50):
        path = disk.folder / f"{draw}"
        file = disk.open(path, False)
        file.write(SYNCED)
        file.sync()
        file.write(WRITTEN)
        file.lose_power(Random(draw))
        data = path.read_bytes()
        assert data[: len(SYNCED)] == SYNCED
        assert len(data) <= len(SYNCED) + len(WRITTEN)
        assert {*data[len(SYNCED) :]} <= {0, 255}
        kept.add(data)
    assert len(kept) > 25, "the losses are all alike"
    assert any(0 in data[len(SYNCED) :] for data in kept), "no block is missing before one that is there"


def test_a_loss_of_power_spares_what_was_synced_where_somebody_else_had_begun(disk: Disk) -> None:
    path = disk.folder / "a"
    disk.open(path, False).write(WRITTEN)
    file = disk.open(path, True)
    file.write(SYNCED)
    file.sync()
    disk.lose_power(1)
    assert path.read_bytes() == SYNCED


def test_a_full_disk_takes_what_there_is_room_for(disk: Disk) -> None:
    disk.room = 10
    file = disk.open(disk.folder / "a", False)
    file.write(b"123456")
    with pytest.raises(OSError, match="No space left"):
        file.write(b"7890ab")
    assert (disk.folder / "a").read_bytes() == b"1234567890"


def test_a_kill_in_the_midst_of_a_write_leaves_a_part_of_it(disk: Disk) -> None:
    disk.tears[1] = 128
    file = disk.open(disk.folder / "a", False)
    file.write(b"1234")
    with pytest.raises(Killed):
        file.write(b"5678")
    assert (disk.folder / "a").read_bytes() == b"123456"


def test_a_file_that_exists_is_replaced_only_if_it_may_be(disk: Disk) -> None:
    disk.open(disk.folder / "a", False)
    disk.open(disk.folder / "a", True)
    with pytest.raises(FileExistsError):
        disk.open(disk.folder / "a", False)
