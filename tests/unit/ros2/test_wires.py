"""Keys and tokens of zenoh-bridge-ros2dds, by the text and the tests of its sources."""

import pytest
from dynpf_formats.ros2.keys import LATCHED, NO_HASH, SENSOR_DATA, Entity, Published, Qos
from dynpf_formats.ros2.wires import RmwZenoh, Ros2dds
from hypothesis import given
from hypothesis import strategies as st

SCAN = Published("/bot1/scan", "sensor_msgs/msg/LaserScan", NO_HASH)
TOKEN = "@/9c73d867f1/@ros2_lv/MP/bot1§scan/sensor_msgs§msg§LaserScan/:0:0:0,10"


def entity(**changes):
    return Entity(0, "9c73d867f1", 0, 0, "MP", "/", "", SCAN, SENSOR_DATA)._replace(**changes)


def test_a_key_is_the_topic_alone_and_a_token_tells_type_and_quality_of_service():
    wire = Ros2dds()
    assert wire.key(SCAN) == "bot1/scan"
    assert wire.token(entity()) == TOKEN
    assert wire.entity(TOKEN) == entity()
    latched = wire.token(entity(kind="MS", qos=LATCHED))
    assert latched == "@/9c73d867f1/@ros2_lv/MS/bot1§scan/sensor_msgs§msg§LaserScan/:1:1:0,1"
    assert wire.entity(latched) == entity(kind="MS", qos=LATCHED)


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        (":::", Qos(reliable=False, depth=1)),
        ("K:::", Qos(reliable=False, depth=1)),
        (":1::", Qos(depth=1)),
        ("::1:", Qos(reliable=False, latched=True, depth=1)),
        (":::0,3", Qos(reliable=False, depth=3)),
        (":1:1:1,-1", Qos(latched=True, depth=1)),
    ],
)
def test_what_is_left_out_of_the_quality_of_service_is_as_dds_has_it(text, qos):
    found = Ros2dds().entity(TOKEN.rpartition("/")[0] + "/" + text)
    assert found is not None
    assert found.qos == qos


@pytest.mark.parametrize(
    "token",
    [
        "",
        "@/9c73d867f1/@ros2_lv",
        TOKEN.replace("MP", "SS"),
        TOKEN.replace("bot1§scan", "bot1§§scan"),
        TOKEN.replace("sensor_msgs§msg§LaserScan", "LaserScan"),
        TOKEN + "0000000000",
        TOKEN.replace(":0:0:0,10", ":::x"),
    ],
)
def test_other_tokens_are_none(token):
    assert Ros2dds().entity(token) is None


@given(st.text())
def test_any_text_is_read_without_an_error(text):
    assert Ros2dds().entity(text) is None
    found = Ros2dds().entity(f"@/z/@ros2_lv/MP/{text}/sensor_msgs§msg§LaserScan/:::")
    assert found is None or found.published == Published("/" + text.replace("§", "/"), SCAN.type, NO_HASH)


def test_only_tokens_tell_which_topics_have_a_type():
    assert Ros2dds().expression("**", SCAN.type) is None
    assert Ros2dds().expression("bot1/scan", SCAN.type) == "bot1/scan"
    assert RmwZenoh(3).expression("**", SCAN.type) == "3/**/sensor_msgs::msg::dds_::LaserScan_/*"
