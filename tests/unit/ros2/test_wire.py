"""Keys, tokens, attachments and type hashes, against what rmw_zenoh's sources and the official packages say."""

import pytest
import zenoh.ext
from dynpf_formats.ros2.attachment import Attachment, BadAttachmentError, Lost, Numbers
from dynpf_formats.ros2.clock import RobotClock, Told
from dynpf_formats.ros2.keys import LATCHED, NO_HASH, RELIABLE, SENSOR_DATA, Entity, Published, Qos
from dynpf_formats.ros2.types import BadRosMessageError, RosTypes
from hypothesis import given
from hypothesis import strategies as st

# From share/PACKAGE/msg/NAME.json of the official packages (Jazzy, Kilted).
HASHES = {
    "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "nav_msgs/msg/OccupancyGrid": "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
    "geometry_msgs/msg/PoseArray": "af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
}
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TOKEN = (
    "@ros2_lv/0/9c73d867f1/0/1/MP/%/%/dynpf/%amcl_pose/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/RIHS01_"
    f"{HASHES[POSE]}/:1:,1:,:,:,,"
)


@pytest.fixture(scope="module")
def types():
    return RosTypes()


def test_types_have_the_hashes_of_the_official_packages(types):
    assert {kind: types.hash(kind) for kind in HASHES} == {kind: f"RIHS01_{text}" for kind, text in HASHES.items()}


def test_a_key_is_that_of_rmw_zenoh_and_is_read_back(types):
    scan = Published("/robot/scan", "sensor_msgs/msg/LaserScan", types.hash("sensor_msgs/msg/LaserScan"))
    key = f"3/robot/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_{HASHES['sensor_msgs/msg/LaserScan']}"
    assert scan.key(3) == key
    assert Published.parse(key) == scan


def test_a_key_of_humble_has_no_hash():
    found = Published.parse(f"0/scan/sensor_msgs::msg::dds_::LaserScan_/{NO_HASH}")
    assert found is not None
    assert found.hash == NO_HASH


@pytest.mark.parametrize(
    "key",
    [
        "",
        "0",
        "x/scan/sensor_msgs::msg::dds_::LaserScan_/TypeHashNotSupported",
        "0/scan/LaserScan/TypeHashNotSupported",
        "0/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_12",
        "0/a b/std_msgs::msg::dds_::String_/" + NO_HASH,
    ],
)
def test_other_keys_are_none(key):
    assert Published.parse(key) is None


def test_a_token_is_that_of_rmw_zenoh_and_is_read_back():
    entity = Entity(0, "9c73d867f1", 0, 1, "MP", "/", "dynpf", Published("/amcl_pose", POSE, "RIHS01_" + HASHES[POSE]))
    assert entity._replace(qos=LATCHED).token() == TOKEN
    assert Entity.parse(TOKEN) == entity._replace(qos=LATCHED)


@pytest.mark.parametrize(
    ("qos", "text"),
    [(Qos(), "::,:,:,:,,"), (RELIABLE, "::,10:,:,:,,"), (SENSOR_DATA, "2::,10:,:,:,,"), (LATCHED, ":1:,1:,:,:,,")],
)
def test_quality_of_service_is_written_without_its_defaults(qos, text):
    assert qos.text() == text
    assert Qos.parse(text) == qos


@given(st.text())
def test_any_text_is_read_without_an_error(text):
    assert Qos.parse(text) is None or text.count(":") == 5
    assert Entity.parse(text) is None
    assert Published.parse(text) is None


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_has_the_bytes_of_zenohs_own_serializer(sequence, stamp_ns, publisher):
    data = Attachment(sequence, stamp_ns, publisher).encode()
    serialized = zenoh.ext.z_serialize((zenoh.ext.Int64(sequence), zenoh.ext.Int64(stamp_ns), publisher))
    assert data == serialized.to_bytes()
    assert Attachment.decode(data) == (sequence, stamp_ns, publisher)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "of 0 bytes"),
        (b"\x0fsequence_number" + bytes(40), "before April 2025"),
        (Attachment(-1, 1, bytes(16)).encode(), "number -1"),
    ],
)
def test_another_attachment_is_refused(data, reason):
    with pytest.raises(BadAttachmentError, match=reason):
        Attachment.decode(data)


def test_lost_messages_are_found_for_each_publisher():
    numbers, one, other = Numbers(), bytes(16), bytes([1] * 16)
    assert numbers.see(Attachment(5, 0, one)) is None  # who joins late has lost nothing
    assert numbers.see(Attachment(6, 0, one)) is None
    assert numbers.see(Attachment(9, 0, one)) == Lost(7, 8)
    assert numbers.see(Attachment(1, 0, other)) is None  # the publisher was started again
    with pytest.raises(BadAttachmentError, match="again, or late"):
        numbers.see(Attachment(8, 0, one))


def test_a_message_is_encoded_as_cdr(types):
    data = types.encode("std_msgs/msg/String", types.make("std_msgs/msg/String", "hello"))
    assert data[:14] == bytes.fromhex("00010000 06000000") + b"hello\0"
    assert types.decode("std_msgs/msg/String", data).data == "hello"


@given(st.binary(max_size=200))
def test_any_bytes_are_decoded_or_refused(data):
    for kind in ("sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/OccupancyGrid"):
        with pytest.raises(BadRosMessageError):
            _TYPES.decode(kind, data)
            raise BadRosMessageError("decoded")


_TYPES = RosTypes()


def test_a_clock_that_jumps_goes_on_in_the_run_and_one_wrong_stamp_is_left_out():
    clock, second = RobotClock(), 10**9
    assert clock.take(100 * second, 1 * second) == Told(100 * second, False)
    assert clock.take(500 * second, 2 * second) is None  # one wrong stamp
    assert clock.take(102 * second, 3 * second) == Told(102 * second, False)
    assert clock.take(7 * second, 4 * second) is None  # back to the beginning of a simulation
    assert clock.take(8 * second, 5 * second) == Told(104 * second, True)
    assert clock.take(9 * second, 6 * second) == Told(105 * second, False)
    assert clock.robot_ns(105 * second) == 9 * second
