"""Maps of map_server as attachments: byte by byte, and refused where they are no maps."""

import json
from pathlib import Path

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main

from dynpf.maps.map_server import decode

REAL = Path(__file__).parents[3] / "../shared/data"
real = pytest.mark.skipif(not REAL.is_dir(), reason=f"the maps are not at {REAL}")

YAML = (
    "image: house.pgm\nresolution: 0.1\norigin: [-1.0, 2.0, 0.5]\n"
    "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)
IMAGE = b"P5\n3 1\n255\n\x00\xfe\xcd"


def test_a_map_is_attached_byte_by_byte_and_its_cells_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, output = tmp_path / "house.yaml", tmp_path / "house.mcap"
    (tmp_path / "images").mkdir()
    source.write_text(YAML.replace("house.pgm", "images/house.pgm"))
    (tmp_path / "images" / "house.pgm").write_bytes(IMAGE)
    assert main(["import", "map", str(source), "-o", str(output), "--json"]) == 0
    settings = json.loads(capsys.readouterr().out)["settings"]
    assert settings == {
        "width": 3,
        "height": 1,
        "resolution_m": 0.1,
        "origin": [-1.0, 2.0, 0.5],
        "occupied": 1,
        "free": 1,
    }
    files = {one.name: one.data for one in read_recording(output).attachments}
    assert files == {"files/house.yaml": source.read_bytes(), "files/house.pgm": IMAGE}
    assert main(["doctor", str(output)]) == 0


@pytest.mark.parametrize(
    ("key", "found"),
    [
        ("image: house.pgm", "image: ~/house.pgm"),
        ("image: house.pgm", "image: .\\house.pgm"),
        ("resolution: 0.1", "resolution:\t0.1"),
        ("negate: 0", "negate: 0\nmode: Trinary"),
    ],
)
def test_maps_as_other_programs_leave_them_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], key: str, found: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "house.yaml").write_text(YAML.replace(key, found))
    (tmp_path / "house.pgm").write_bytes(IMAGE)
    assert main(["import", "map", str(tmp_path / "house.yaml"), "-o", str(tmp_path / "a.mcap"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"]["resolution_m"] == 0.1
    files = {one.name: one.data for one in read_recording(tmp_path / "a.mcap").attachments}
    text = files["files/house.yaml"].decode()
    grid = decode(text, lambda name: files[f"files/{name.rpartition('/')[2]}"], "house.yaml")
    assert grid.cells.tolist() == [[1, 0, 2]]


@pytest.mark.parametrize(
    ("text", "image", "told"),
    [
        (YAML.replace("-1.0", ".nan"), IMAGE, "origin = [nan, 2.0, 0.5]; expected [x, y, yaw]"),
        (YAML, None, "image = 'house.pgm' cannot be read: no such file"),
        (YAML, b"version https://git-lfs.github.com/spec/v1\n", "image = 'house.pgm' is a Git LFS pointer"),
        (YAML, b"P5\n3 1\n255\n\x00", "image = 'house.pgm' is"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", IMAGE, "a Git LFS pointer"),
        ("- 1\n", IMAGE, "expected the keys of a map_server file"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, image: bytes | None, told: str
) -> None:
    source, output = tmp_path / "house.yaml", tmp_path / "house.mcap"
    source.write_text(text)
    if image is not None:
        (tmp_path / "house.pgm").write_bytes(image)
    assert main(["import", "map", str(source), "-o", str(output)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"dynpf import: {source}: ")
    assert told in line
    assert not output.exists()


@real
def test_the_real_maps_come_over_and_the_broken_ones_do_not(tmp_path: Path) -> None:
    codes = {}
    for source in sorted((REAL / "maps").rglob("*.yaml")):
        output = tmp_path / f"{source.stem}.mcap"
        codes[source.stem] = main(["import", "map", str(source), "-o", str(output)])
        if codes[source.stem] == 0:
            files = {one.name.removeprefix("files/"): one.data for one in read_recording(output).attachments}
            assert {(source.parent / name).read_bytes() for name in files} == set(files.values())
            assert decode(files[source.name].decode(), files.__getitem__, source.name).cells.size
    assert {name for name, code in codes.items() if code} == {"invalid_image", "testmap"}
    assert len(codes) == 7
