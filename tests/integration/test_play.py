"""A recording that is played onto the bus."""

import json

from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.keys import DATA
from dynpf_runtime.bus.processes import free_port
from dynpf_runtime.bus.session import open_router
from dynpf_runtime.machines.events import Arrived

from tests.integration.processes import until


def test_play_publishes_every_message_of_the_chosen_topics(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    assert here("run", "landmark-room", "--set", "max_ticks=20", "--runner", "inline", "-o", path).code == 0
    topics = ("sensors/odometry", "estimator/state")
    expected = [one for one in read_recording(path).messages() if one.topic in topics]
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_router(endpoint) as bus:
        bus.subscribe(f"{DATA}**")
        play = dynpf("play", path, "--rate", "20", "--topics", *topics, "--connect", endpoint)
        arrived = []
        for _ in expected:
            one = until(lambda: bus.receive(0.1), "a message")
            assert isinstance(one, Arrived)
            arrived.append(one)
        assert play.wait() == 0, play.stderr
        assert bus.receive(0.0) is None
    assert play.stdout == f"played {len(expected)} messages\n"

    def key(topic, envelope):
        return topic, envelope.node, envelope.boot, envelope.sequence, envelope.stamp_ns

    sent = {key(one.topic, one): one.payload for one in expected}
    assert {key(one.key.removeprefix(DATA), decode_envelope(one.attachment)): one.payload for one in arrived} == sent
    assert len(sent) == len(expected) == 40
    ticks = [decode_envelope(one.attachment).tick for one in arrived]
    assert ticks == sorted(ticks)
    assert json.loads(arrived[-1].payload)


def test_play_refuses_topics_that_the_recording_lacks(tmp_path, here):
    path = tmp_path / "run.mcap"
    assert here("run", "landmark-room", "--set", "max_ticks=3", "--runner", "inline", "-o", path).code == 0
    for topic in ("camera/image", "no/such/topic"):
        refused = here("play", path, "--topics", topic)
        assert refused.code == 2
        assert topic in refused.err
        assert refused.err.count("\n") == 1
