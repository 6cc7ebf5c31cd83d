"""What is said over Zenoh is recorded with what is lost of it, readable by others, and nothing on the bus ends that."""

import json
import re

import pytest
import zenoh
from dynpf_formats.capture.reader import Found, found_in, read_capture
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import Published
from dynpf_formats.ros2.types import RosTypes
from dynpf_runtime.bus.processes import free_port
from mcap.reader import make_reader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg, get_typestore
from rosbags.typesys.stores import Stores

from tests.integration.processes import until
from tests.integration.robots import live_robot, router

STRING = "std_msgs/msg/String"
ONE, OTHER = b"1" * 16, b"2" * 16


@pytest.fixture(scope="module")
def types():
    return RosTypes()


def client(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def talk(session: zenoh.Session, types: RosTypes, topic: str, *numbers: int, publisher: bytes = ONE) -> None:
    """Say a word on a ROS topic for each of the numbers, each at the time of its number."""
    key = Published(topic, STRING, types.hash(STRING)).key(0)
    for number in numbers:
        payload = types.encode(STRING, types.make(STRING, f"word {number}"))
        session.put(key, payload, attachment=Attachment(number, number, publisher).encode())


def test_a_recording_is_read_by_others_and_tells_its_losses(tmp_path, dynpf, here, types):
    path = tmp_path / "F.mcap"
    with live_robot(types) as (endpoint, robot), client(endpoint) as session:
        run = dynpf("record", "--connect", endpoint, "-o", path, "--json")
        run.says("/scan: sensor_msgs/msg/LaserScan")  # so all is heard from now on
        talk(session, types, "/talk", 1, 2, 4, 3, 3, 8)
        talk(session, types, "/talk", 1, 2, publisher=OTHER)  # another that was started, or the same again
        session.put("door/\x1b[31mopen", b'{"open": true}', encoding="application/json")
        noise = Published("/noise", STRING, types.hash(STRING)).key(0)
        session.put(noise, b"\0\1\0\0\xff\xff\xff\xff", attachment=Attachment(7, 1, ONE).encode())
        session.put(noise, types.encode(STRING, types.make(STRING, "sense")))
        run.says("/noise: std_msgs/msg/String")
        run.says("/scan: message ")
        ears = {
            one.published.topic
            for one in robot.entities()
            if one.published is not None and (one.kind, one.node) == ("MS", "dynpf_record")
        }
        run.interrupt()
        assert run.wait() == 0, run.stderr
    assert "\x1b" not in run.stderr
    assert {"/map", "/odom", "/scan"} <= ears  # some publish only if somebody hears them

    told = json.loads(run.stdout)
    assert told["complete"]
    assert told["dropped"] == 0
    senders = {(one["topic"], one["publisher"]): one for one in told["publishers"]}
    first, second = (senders["/talk", publisher.hex()] for publisher in (ONE, OTHER))
    assert first["lost"] == [[5, 7]]
    assert [first[name] for name in ("received", "missing", "duplicates", "late")] == [6, 3, 1, 1]
    assert [second[name] for name in ("received", "missing", "duplicates", "late")] == [2, 0, 0, 0]
    assert told["topics"]["/noise"]["without_numbers"] == 1
    assert told["topics"]["door/\x1b[31mopen"]["type"] == "application/json"

    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        scans = [message.sequence for _, _, message in reader.iter_messages(topics=["/scan"])]
        words = [message.sequence for _, _, message in reader.iter_messages(topics=["/talk"], log_time_order=False)]
        doors = [
            (channel.message_encoding, message.data)
            for _, channel, message in reader.iter_messages(["door/\x1b[31mopen"])
        ]
    skipped = sorted({*range(scans[0], scans[-1])} - {*scans})
    assert skipped  # the robot loses every tenth
    ((_, lost),) = [(key, one["lost"]) for key, one in senders.items() if key[0] == "/scan"]
    assert lost == [[number, number] for number in skipped]
    assert words == [1, 2, 4, 3, 3, 8, 1, 2]
    assert doors == [("json", b'{"open": true}')]

    doctor = here("doctor", path, "--json")
    assert doctor.code == 1
    findings = [(one["severity"], one["where"], one["what"]) for one in json.loads(doctor.out)["findings"]]
    assert ("error", "/talk", "3 messages of publisher 31313131 never came: numbers 5 to 7") in findings
    assert {where for severity, where, _ in findings if severity == "error"} == {"/talk", "/scan"}
    assert any(what.startswith("1 messages are no std_msgs/msg/String") for _, _, what in findings)
    info = json.loads(here("info", path, "--json").out)
    assert {name: info[name] for name in ("topics", "publishers", "missing")} == {
        name: told[name] for name in ("topics", "publishers", "missing")
    }

    with Reader(path) as bag:
        offered = {
            one.topic: one.ext.offered_qos_profiles
            for one in bag.connections
            if isinstance(one.ext, ConnectionExtRosbag2)
        }
    assert offered["/map"][0].durability.name == "TRANSIENT_LOCAL"
    assert offered["/scan"][0].reliability.name == "BEST_EFFORT"
    assert [word.data for word in words_by_rosbags(path)] == [f"word {number}" for number in words]
    imported = here("import", "rosbag", path, "-o", tmp_path / "log.mcap")
    assert imported.code == 0, imported.err
    assert re.search(rf"log/scan +{len(scans)}\n", imported.out)
    assert "files/map.yaml" in imported.out  # latched before the recorder came


def words_by_rosbags(path):
    """Return the words of /talk, decoded by what the file itself says of their type."""
    with Reader(path) as reader:
        connections = [one for one in reader.connections if one.topic == "/talk"]
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(connections[0].msgdef.data, STRING))
        return [store.deserialize_cdr(data, one.msgtype) for one, _, data in reader.messages(connections)]


def test_what_is_in_a_chunk_survives_a_kill(tmp_path, dynpf, here, types):
    path, mended = tmp_path / "F.mcap", tmp_path / "mended.mcap"
    with live_robot(types) as (endpoint, _), client(endpoint) as session:
        run = dynpf("record", "/scan", "/talk", "--connect", endpoint, "-o", path)
        run.says("/scan: sensor_msgs/msg/LaserScan")
        talk(session, types, "/talk", 1, 2, 4)
        until(lambda: read_capture(path).tally.topics.get("/talk"), "a chunk with the words")
        before = read_capture(path).tally
        run.popen.kill()
        run.wait()
    found = here("doctor", path)
    assert found.code == 1
    assert f"dynpf recover {path}" in found.out
    assert here("recover", path, "-o", mended).code == 0
    after = read_capture(mended)
    assert after.tally.messages >= before.messages > 3
    assert {sender.topic: sender.series.lost for sender in after.tally.senders}["/talk"] == ((3, 3),)
    assert not after.damage
    assert [word.data for word in words_by_rosbags(mended)] == ["word 1", "word 2", "word 4"]
    assert "recovered: " in here("info", mended).out


def test_a_router_that_is_late_or_restarts_is_waited_for(tmp_path, dynpf, here, types):
    path, endpoint = tmp_path / "F.mcap", f"tcp/127.0.0.1:{free_port()}"
    run = dynpf("record", "/talk", "--connect", endpoint, "-o", path)
    run.says("waits for the router")
    with router(endpoint):
        run.says("records ")
        with client(endpoint) as session:
            until(lambda: _said(path, session, types, 1), "a chunk with a word")
    run.says("the router is gone")
    with router(endpoint):
        run.says("the router is back")
        with client(endpoint) as session:
            until(lambda: _said(path, session, types, 9), "a chunk with another word")
        run.interrupt()
        assert run.wait() == 0, run.stderr
    doctor = here("doctor", path)
    assert doctor.code == 1
    assert "no router for " in doctor.out
    assert "numbers 2 to 8" in doctor.out


def _said(path, session, types, number):
    """Say a word, and return whether it is in the file by now."""
    talk(session, types, "/talk", number)
    return any(isinstance(found, Found) and found.sequence == number for found in found_in(path))


def test_a_key_that_is_none_is_told_before_anything_else(tmp_path, here):
    told = here("record", "a//b", "--connect", "tcp/127.0.0.1:1", "-o", tmp_path / "F.mcap")
    assert told.code == 2
    assert "'a//b': no key expression of Zenoh, nor a ROS topic such as /scan" in told.err
