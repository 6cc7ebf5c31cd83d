"""A stranger on a bus without keys: what it sends is refused, counted and told, and the run goes on without it."""

import json
import re

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import encode
from dynpf_protocol.control import Recorded, Stop, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.keys import BEAT, DATA, RECORDED, STOP, TICK
from dynpf_systems.parts.messages import Detections

from tests.integration.processes import watch_run

TOPIC = "sensors/overhead"


def test_what_a_stranger_publishes_is_refused_and_changes_nothing(tmp_path, dynpf, here):
    path, undisturbed = tmp_path / "run.mcap", tmp_path / "undisturbed.mcap"
    words = ["parts-3-tracked", "--set", "max_ticks=400"]
    run = dynpf("run", *words, "--insecure", "-o", path)
    with watch_run(tmp_path, run) as watched:
        watched.await_ticks(30)
        boot = watched.boot("sensors")
        good = encode(TOPIC, Detections(discs=()), known_topics())

        def put(topic, payload, node="", boot="", sequence=0):
            place = Envelope(node, boot, sequence, 1, 0, 0) if node else None
            watched.bus.put(DATA + topic, payload, encode_envelope(place) if place else b"")

        put(TOPIC, b'{"discs": [{"x": "no number"', "sensors", "deadbeef", 10**6)
        put(TOPIC, good)
        put(TOPIC, good, "nobody", boot, 10**6)
        put(TOPIC, good, "sensors", "deadbeef", 10**6)
        put(TOPIC, good, "sensors", boot, 3)
        put(TOPIC, b"\xff\x00", "sensors", boot, 4)
        put("no/such/topic", good, "sensors", boot, 0)
        for key in (f"{TICK}sensors", f"{BEAT}sensors", f"{STOP}sensors", RECORDED):
            watched.bus.put(key, b"\xff")
        watched.bus.put(f"{STOP}sensors", encode_control(Stop("sensors", "deadbeef", "enough")))
        watched.bus.put(RECORDED, encode_control(Recorded("deadbeef", False, "no room left", "run.mcap")))
        watched.await_ticks(30)
    assert run.wait() == 0, run.stderr
    assert "Traceback" not in run.stderr

    assert here("run", *words, "--runner", "inline", "-o", undisturbed).code == 0
    recording = read_recording(path)
    assert content_digest(recording) == content_digest(read_recording(undisturbed))
    assert here("replay", path).code == 0

    diagnostics = [json.loads(one.payload) for one in recording.messages("diagnostics", "estimator")]
    assert diagnostics[0]["refused"] == {}
    assert diagnostics[-1]["refused"] == {TOPIC: 6, "tick/sensors": 1, "control and beats": 5}
    told = "\n".join(
        json.loads(one.payload)["message"] for one in (*recording.messages("log"), *recording.messages("notice"))
    )
    for reason in (
        f"{TOPIC}: message refused: unreadable envelope",
        f"{TOPIC}: message refused: unknown sender 'sensors' with boot 'deadbeef'",  # the first of its kind
        f"{TOPIC}: message refused: tick 1 at 0 ns; expected",
        "no/such/topic: message refused: topic 'no/such/topic' is not in the topic table",
    ):
        assert reason in told
        assert reason in run.stderr
    # Of control and beats the first that comes is told, and subscriptions keep no order among each other.
    first = r"(beat/sensors|control/stop/sensors|control/recorded)"
    for name, key in (("estimator", "tick/sensors"), ("estimator", first), ("router", "control/recorded")):
        assert re.search(rf"dynpf {name}: {key}: message refused", run.stderr)
    assert "recorder: log: message refused" not in run.stderr  # what the hosts say of it is in the recording
