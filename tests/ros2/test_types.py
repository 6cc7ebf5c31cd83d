"""Types, bytes, tokens and attachments against ROS 2's own packages and zenoh-ros2-sdk."""

import pytest
from dynpf_formats.importers.bag_plan import TRANSFORMS, TYPES
from dynpf_formats.ros2.answers import ANSWERS
from dynpf_formats.ros2.attachment import Attachment, publisher_id
from dynpf_formats.ros2.keys import LATCHED, RELIABLE, SENSOR_DATA, Entity, Published
from dynpf_formats.ros2.robot import CLOCK, IMU, INITIAL_POSE
from dynpf_formats.ros2.xxh3 import xxh3_128

from tests.ros2.oracle import plain

USED = sorted({CLOCK, IMU, INITIAL_POSE, *TYPES, *(kind.type for kind in ANSWERS)} - {TRANSFORMS[1]})
WHEELS = [kind for kind in USED if kind.split("/")[0] not in {"tf2_msgs", "nav2_msgs"}]
IDL = {
    "tf2_msgs": {
        "TFMessage": """#include "geometry_msgs/msg/TransformStamped.idl"
            module tf2_msgs { module msg { struct TFMessage {
              sequence<geometry_msgs::msg::TransformStamped> transforms; }; }; };"""
    },
    "nav2_msgs": {
        "Particle": """#include "geometry_msgs/msg/Pose.idl"
            module nav2_msgs { module msg { struct Particle {
              geometry_msgs::msg::Pose pose; double weight; }; }; };""",
        "ParticleCloud": """#include "std_msgs/msg/Header.idl"
            #include "nav2_msgs/msg/Particle.idl"
            module nav2_msgs { module msg { struct ParticleCloud {
              std_msgs::msg::Header header; sequence<nav2_msgs::msg::Particle> particles; }; }; };""",
    },
}


def test_types_have_the_hashes_in_the_packages_of_ros(theirs, types):
    assert len(WHEELS) >= 11
    assert {kind: types.hash(kind) for kind in WHEELS} == theirs.ask("hashes", kinds=WHEELS)


@pytest.mark.parametrize("package", IDL)
def test_types_without_packages_have_the_hashes_of_ros_own_generator(package, theirs, types):
    found = theirs.ask("generated_hashes", package=package, idl=IDL[package])
    assert found == {kind: types.hash(kind) for kind in found}
    assert {kind for kind in USED if kind.startswith(package)} <= found.keys()


@pytest.mark.parametrize("kind", USED)
def test_the_sdk_computes_the_same_hash(kind, theirs, types):
    assert theirs.ask("computed_hash", kind=kind) == types.hash(kind)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", WHEELS)
def test_bytes_by_rclpy_are_read_and_ours_are_read_by_rclpy(kind, seed, theirs, types):
    message = theirs.ask("serialized", kind=kind, seed=seed)
    read = types.decode(kind, bytes.fromhex(message["data"]))
    assert plain(read) == message["told"]
    assert theirs.ask("deserialized", kind=kind, data=types.encode(kind, read).hex()) == message["told"]


@pytest.mark.parametrize("size", [17, 32, 33, 64, 65, 96, 97, 128, 129, 160, 239, 240, 241, 256, 257, 1023, 1024])
def test_the_hash_that_names_a_publisher_is_xxh3(size, theirs):
    text = "".join(chr(33 + number * 7 % 90) for number in range(size))
    assert xxh3_128(text.encode()).to_bytes(16, "little").hex() == theirs.ask("xxh3", text=text)


@pytest.mark.parametrize("size", [16, 1025])
def test_other_sizes_are_refused(size):
    with pytest.raises(ValueError, match=f"{size} bytes"):
        xxh3_128(bytes(size))


def test_a_publisher_has_the_name_of_its_token_and_the_sdk_reads_its_attachments(theirs, types):
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    published = Published("/bot1/amcl_pose", kind, types.hash(kind))
    token = Entity(0, "9c73d8a567f1", 0, 12, "MP", "/bot1", "dynpf", published, LATCHED).token()
    name = theirs.ask("xxh3", text=token)
    assert publisher_id(token).hex() == name
    data = Attachment(7, 1_700_000_000_000_000_001, publisher_id(token)).encode()
    assert theirs.ask("attachment", data=data.hex()) == [7, 1_700_000_000_000_000_001, name]


@pytest.mark.parametrize(
    ("qos", "told"),
    [
        (LATCHED, ["RELIABLE", "TRANSIENT_LOCAL", 1]),
        (RELIABLE, ["RELIABLE", "VOLATILE", 10]),
        (SENSOR_DATA, ["BEST_EFFORT", "VOLATILE", 10]),
    ],
)
def test_the_sdk_understands_a_quality_of_service(qos, told, theirs):
    assert theirs.ask("quality", text=qos.text()) == told
