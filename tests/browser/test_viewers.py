"""What Foxglove's own packages read of an export: every message of every channel, by Foxglove's schemas."""

import json
import subprocess
from pathlib import Path

import pytest
from dynpf_lab.cli.main import main

from tests.browser.test_pages import HERE, ROOT, command, packages

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]

__all__ = ["packages"]

RECORDED = ("camera", "colon", "faults", "landmarks", "rearrangement")


def test_every_channel_is_read_and_has_all_fields_of_its_schema(packages: Path, tmp_path: Path) -> None:
    assert packages.is_dir()
    files = [tmp_path / f"{name}.mcap" for name in RECORDED]
    for file in files:
        words = ["export", str(ROOT / "recordings" / file.name), "--format", "foxglove", "-o", str(file)]
        assert main(words) == 0
    words = [command("node"), "viewers.mjs", *map(str, files)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=HERE)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    channels = [(topic, row) for found in told.values() for topic, row in found.items()]
    binary = {topic: row for topic, row in channels if row["encoding"] == "protobuf"}
    assert {row["schema"] for row in binary.values()} >= {
        "foxglove.CompressedImage",
        "foxglove.FrameTransforms",
        "foxglove.PointCloud",
        "foxglove.PoseInFrame",
        "foxglove.PosesInFrame",
        "foxglove.SceneUpdate",
    }
    assert all(row["known"] and not row["missing"] for row in binary.values())
    assert any(topic == "figures/position_error/error" and '"value"' in row["last"] for topic, row in channels)
