"""A map drawn from a log's own scans: a square room, seen from two places, comes out where it is."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main

from dynpf.maps.map_server import decode
from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.measurement.ray import ray_segments

WALLS = np.array([(0, 0, 4, 0), (4, 0, 4, 3), (4, 3, 0, 3), (0, 3, 0, 0)], dtype=np.float64)


def lines(truth: bool = True) -> Iterator[str]:
    for stamp, (x, y, theta) in enumerate(
        [(1.0, 1.0, 0.3), (3.0, 2.0, 2.0), (2.0, 1.5, -1.4), (2.0, 1.5, 1.7)], start=1
    ):
        angles = theta - math.pi / 2 + np.arange(360) * math.pi / 360
        ranges = ray_segments(np.array([x, y]), angles, WALLS)
        told = " ".join(f"{one:.3f}" for one in ranges)
        there = f"{x} {y} {theta}" if truth else "0 0 0"
        yield f"FLASER 360 {told} {there} 0 0 0 {stamp} h {stamp}\n"


def drawn(tmp_path: Path) -> OccupancyGrid:
    source, output = tmp_path / "log.txt", tmp_path / "log.mcap"
    source.write_text("".join(lines()))
    assert main(["import", "carmen", str(source), "--map-from-poses", "0.1", "-o", str(output)]) == 0
    files = {one.name.removeprefix("files/"): one.data for one in read_recording(output).attachments}
    return decode(files["map.yaml"].decode(), files.__getitem__, "map.yaml")


def test_walls_are_occupied_the_room_is_free_and_the_rest_unknown(tmp_path: Path) -> None:
    grid = drawn(tmp_path)
    assert grid.resolution == 0.1
    row, column = np.nonzero(grid.occupied)
    x, y = grid.to_map(column + 0.5, row + 0.5)
    from_wall = np.minimum.reduce([np.abs(x), np.abs(x - 4), np.abs(y), np.abs(y - 3)])
    assert from_wall.max() <= 0.1
    assert len(row) > 120  # of the walls' 140 cells

    def cell(x: float, y: float) -> int:
        column, row = grid.to_cells(x, y)
        return int(grid.cells[int(row), int(column)])

    assert cell(2.0, 1.5) == cell(3.55, 0.55) == FREE
    assert cell(-0.5, 1.5) == cell(4.5, 1.5) == UNKNOWN
    assert OCCUPIED in (cell(1.55, 2.95), cell(1.55, 3.05))


def test_without_known_poses_there_is_no_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, output = tmp_path / "log.txt", tmp_path / "log.mcap"
    source.write_text("".join(lines(truth=False)))
    assert main(["import", "carmen", str(source), "--map-from-poses", "0.1", "-o", str(output)]) == 2
    assert "no map can be drawn" in capsys.readouterr().err
    assert not output.exists()
