"""Small recorded runs of every kind, to be edited: lost messages, a log that is played, diagnostics, an attachment."""

from collections.abc import Sequence
from pathlib import Path

from dynpf_formats.importers.recording import BOOT
from dynpf_formats.recording.attachments import attached_landmarks
from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.provenance import collect
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Diagnostics, LandmarkReading, LandmarkReadings, Message, Odometry, RobotState
from dynpf_protocol.topics import LOG_NODE
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import record_inline

from checks.edits.content import Content, Row, read_content, resealed

__all__ = ["small_runs"]

_LOSSES = "faults=[{topic='sensors/odometry', to='estimator', loss=0.3}]"
_STEP_NS = 100_000_000
_MAPPED = """
title = "A room in a file"
tick_s = 0.1
max_ticks = 8
state_digest_ticks = 4
map = { kind = "occupancy", file = "room.yaml" }
simulator = { kind = "room", start = [1.0, 1.0, 0.0] }
sensors = { kind = "simulated", odometry = {}, scan = { beams = 5 } }
controller = { kind = "waypoints", points = [[2.0, 1.0]] }
[estimator]
kind = "localization"
n = 20
start = { kind = "known", x = 1.0, y = 1.0 }
measurement = "likelihood_field"
"""


def small_runs(folder: Path) -> Sequence[Content]:
    """Record the runs in ``folder`` and return what is in them."""
    room, played, mapped = (folder / f"{name}.mcap" for name in ("room", "played", "mapped"))
    record_inline(load_scenario("landmark-room", overrides=["max_ticks=12", "state_digest_ticks=5", _LOSSES]), room)
    log = _log(folder / "log.mcap")
    record_inline(load_scenario("landmark-mrclam", overrides=["state_digest_ticks=5"], log=log.facts), played, log)
    record_inline(load_scenario(str(_mapped(folder))), mapped)
    return [_with_diagnostics(read_content(path)) for path in (room, played, mapped)]


def _mapped(folder: Path) -> Path:
    """Return a scenario whose map is in two files: 4 m by 3 m within walls, in cells of 0.1 m."""
    wall, row = b"\0" * 40, b"\0" + b"\xfe" * 38 + b"\0"
    (folder / "room.pgm").write_bytes(b"P5\n40 30\n255\n" + wall + row * 28 + wall)
    (folder / "room.yaml").write_text(
        "image: room.pgm\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    path = folder / "mapped.toml"
    path.write_text(_MAPPED)
    return path


def _log(path: Path) -> PlayedLog:
    landmarks = [Landmark(id=number, x=float(number), y=2.0) for number in range(1, 4)]
    header = RunHeader(scenario='{"import":{"source":"made up"}}', seed=0, provenance=collect())
    with RecordingWriter(path, header, (attached_landmarks(landmarks),)) as writer:
        for number in range(10):
            reading = LandmarkReading(landmark=1 + number % 3, range=2.0 + 0.1 * number, bearing=0.1 * number)
            records: list[tuple[str, Message]] = [
                ("log/truth", RobotState(x=0.1 * number, y=0.0, theta=0.0)),
                ("log/odometry", Odometry(v=1.0, w=0.01 * number)),
                ("log/landmarks", LandmarkReadings(readings=(reading,))),
            ]
            for topic, message in records:
                place = Envelope(LOG_NODE, BOOT, number, 0, number * _STEP_NS, number * _STEP_NS)
                writer.message(topic, place, encode(topic, message))
        writer.close(complete=True, reason="imported")
    return PlayedLog(path)


def _with_diagnostics(content: Content) -> Content:
    """Return the content with the diagnostics that the processes of a bus send, too."""
    topic = "diagnostics"
    nodes = {row.node: row.boot for row in content.rows if row.topic == f"journal/{row.node}"}
    reports = [
        Row(
            topic,
            node,
            boot,
            number,
            0,
            0,
            encode(topic, Diagnostics(node=node, steps=number, step_time_s=0.5, refused={}, queue=0)),
        )
        for node, boot in nodes.items()
        for number in range(3)
    ]
    return resealed(content._replace(rows=(*reports, *content.rows)))
