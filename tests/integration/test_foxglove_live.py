"""A run that goes on, as a viewer gets it by Foxglove's WebSocket: all channels, and the values of the recording."""

import json
import re

from dynpf_formats.recording.reader import read_recording

from tests.integration.processes import Child, until
from tests.integration.test_follow import folder_of
from tests.integration.websocket import Viewer

EXPECTED = {
    "estimator/particles": "foxglove.PosesInFrame",
    "estimator/pose": "foxglove.PoseInFrame",
    "estimator/state": "dynpf.Estimate",
    "estimator/transforms": "foxglove.FrameTransforms",
    "figures/health/estimator": "dynpf.Number",
    "map/grid": "foxglove.Grid",
    "sensors/scan": "foxglove.LaserScan",
    "sensors/scan/points": "foxglove.PointCloud",
    "truth/robot/pose": "foxglove.PoseInFrame",
}


def address_of(view: Child) -> str:
    until(lambda: "layout" in view.stdout, "the link of the viewer")
    found = re.search(r"ds=foxglove-websocket&ds\.url=ws%3A%2F%2F127\.0\.0\.1%3A(\d+)", view.stdout)
    assert found is not None, view.stdout
    return f"ws://127.0.0.1:{found[1]}"


def test_a_raw_client_gets_the_live_channels_with_the_values_of_the_recording(tmp_path, dynpf):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "indoor-tracking", "--set", "rate=10", "--no-page", "-o", path)
    folder = folder_of(run)
    until(lambda: path.is_file() and path.stat().st_size > 50_000, "a map and some ticks in the recording")
    view = dynpf("view", folder, "--foxglove", "--no-open")
    viewer = Viewer(address_of(view))
    assert viewer.status.startswith("HTTP/1.1 101")
    assert viewer.agreed
    heard = viewer.messages
    while not (EXPECTED.keys() <= heard.keys() and len(heard["estimator/state"]) >= 20):
        viewer.take()
    viewer.close()
    run.interrupt()
    assert run.wait() == 0, run.stderr
    assert view.wait() == 0, view.stderr
    schemas = {channel["topic"]: channel["schemaName"] for channel in viewer.channels.values()}
    assert {topic: schemas[topic] for topic in EXPECTED} == EXPECTED
    recorded = {record.stamp_ns: record.payload for record in read_recording(path).messages("estimator/state")}
    assert all(recorded[stamp] == payload for stamp, payload in heard["estimator/state"])
    assert json.loads(heard["figures/health/estimator"][-1][1])["value"] in (0.0, 1.0, 2.0)
