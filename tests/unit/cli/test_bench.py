import json
from pathlib import Path

import numpy as np
import pytest
from dynpf_lab.bench import measure, peers
from dynpf_lab.cli.main import main

WORK = ["bench", "--work", "landmarks_15", "--n", "100"]


@pytest.fixture(autouse=True)
def _brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "BUDGET_S", 0.001)
    monkeypatch.setattr(measure, "TURN_S", 1e-6)


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """There is no environment of the peers."""
    monkeypatch.setattr(peers.Peers.__init__, "__defaults__", (peers.PEERS, tmp_path / "python"))


@pytest.mark.usefixtures("alone")
def test_without_peers_their_columns_are_null_and_make_peers_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORK, "--json"]) == 0
    told = capsys.readouterr()
    document = json.loads(told.out)
    assert document["study"] == "bench"
    (row,) = document["rows"]
    assert (row["work"], row["n"], row["threads"], row["beams"]) == ("landmarks_15", 100, 1, None)
    assert all(row[f"{name}_ms"] is row[f"ratio_{name}"] is None for name in peers.PEERS)
    assert row["ours_ms"] > 0.0
    assert told.err.count("\n") == 1
    assert "make peers" in told.err


@pytest.mark.usefixtures("alone")
def test_a_person_gets_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(WORK) == 0
    assert capsys.readouterr().out.startswith("work ")


def test_an_unknown_work_is_wrong_usage_and_the_known_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--work", "beam_6"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("dynpf bench: unknown work 'beam_6'; did you mean 'beam_60'?")
    assert "rays_global, rays_track" in told.err


@pytest.mark.parametrize("words", [["--n", "0"], ["--n", "10,x"], ["--threads", "-1"], ["--beams", "1.5"]])
def test_numbers_are_whole_and_above_zero(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *words]) == 2
    assert "is not a whole number above zero" in capsys.readouterr().err


def test_beams_without_scans_are_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORK, "--beams", "7"]) == 2
    assert "no work with scans" in capsys.readouterr().err


def test_another_map_and_number_of_beams_are_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = np.zeros((40, 60), dtype=np.uint8)
    room[1:-1, 1:-1] = 254
    (tmp_path / "room.pgm").write_bytes(b"P5\n60 40\n255\n" + room.tobytes())
    words = ["--work", "likelihood_field_60", "--n", "1e2", "--beams", "7", "--json"]
    assert main(["bench", "--map", str(tmp_path / "room.pgm"), *words]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert (row["n"], row["beams"]) == (100, 7)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("none.yaml", None, "cannot be read: No such file or directory"),
        ("map.yaml", "image: gone.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n", "map.yaml"),
        ("map.png", "text", "map.png"),
    ],
)
def test_a_map_that_cannot_be_read_is_wrong_usage(
    name: str, content: str | None, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    assert main(["bench", "--map", str(tmp_path / name)]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_a_map_without_walls_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "field.pgm").write_bytes(b"P5\n4 3\n255\n" + bytes([254] * 12))
    assert main(["bench", "--map", str(tmp_path / "field.pgm")]) == 2
    assert "walls and free cells" in capsys.readouterr().err
