"""Another implementation of rmw_zenoh at the other end: topics, messages both ways, latched ones, refused ones."""

import threading
import time

import pytest
from dynpf_formats.importers.bag_plan import BagChoice, planned
from dynpf_formats.importers.bags import Message
from dynpf_formats.importers.log import Losses
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import LATCHED, NO_HASH, RELIABLE, SENSOR_DATA, Published
from dynpf_formats.ros2.robot import Heard, LiveReader, RobotPlan, Said
from dynpf_services.ros2.session import RobotSession

from tests.integration.processes import until
from tests.ros2.oracle import plain

POSE, SCAN = "geometry_msgs/msg/PoseWithCovarianceStamped", "sensor_msgs/msg/LaserScan"
MAP = "nav_msgs/msg/OccupancyGrid"
MANY = 1000


class Ours:
    """A session of the bridge."""

    def __init__(self, session, types):
        self.session, self._types = session, types
        self._came = threading.Condition()
        session.wakes(self._wake)

    def _wake(self):
        with self._came:
            self._came.notify_all()

    def take(self, count, within_s=20.0):
        """Return so many messages, fewer if they do not come in time."""
        found: list[Heard] = []
        ends = time.monotonic() + within_s
        while len(found) < count:
            with self._came:
                if not self._came.wait_for(lambda: self.session.waiting, ends - time.monotonic()):
                    break
            found.append(self.session.take())
        return found

    def ends(self):
        """Return kind and topic of all publishers and subscribers."""
        return [(entity.kind, entity.published) for entity in self.session.entities()]

    def put(self, topic, kind, qos, messages, type_hash=None):
        """Publish messages, once somebody hears them; yield how many were."""
        writer = self.writer(topic, kind, qos, type_hash)
        until(lambda: writer._publisher.matching_status.matching, f"somebody who hears {topic}")
        for number, message in enumerate(messages):
            writer.put(message, number)
            yield number + 1

    def writer(self, topic, kind, qos, type_hash=None):
        return self.session.writer(Published(topic, kind, type_hash or self._types.hash(kind)), qos)


@pytest.fixture
def ours(endpoint, types):
    with RobotSession.connect(endpoint, 0, "/bot1") as session:
        yield Ours(session, types)


def filled(theirs, kind, **fields):
    return theirs.ask("serialized", kind=kind, seed=1)["told"] | fields


def test_topics_and_their_ends_are_found_both_ways(ours, theirs, types):
    _writer = ours.writer("/bot1/listed", POSE, LATCHED)
    ours.session.announce(Published("/bot1/wanted", SCAN, types.hash(SCAN)), SENSOR_DATA)
    topics = {"/bot1/listed": [POSE], "/bot1/wanted": [SCAN]}
    until(lambda: topics.items() <= theirs.ask("topics").items(), "the topics in the SDK's list")
    end = {"node": "dynpf", "namespace": "/bot1"}
    (publisher,) = theirs.ask("topic", name="/bot1/listed")["publishers"]
    assert publisher == {**end, "type": POSE, "hash": types.hash(POSE), "qos": ["RELIABLE", "TRANSIENT_LOCAL", 1]}
    (subscriber,) = theirs.ask("topic", name="/bot1/wanted")["subscribers"]
    assert subscriber == {**end, "type": SCAN, "hash": types.hash(SCAN), "qos": ["BEST_EFFORT", "VOLATILE", 10]}

    theirs.ask("advertise", name="/theirs", kind=SCAN)
    until(lambda: ("MP", Published("/theirs", SCAN, types.hash(SCAN))) in ours.ends(), "the SDK's publisher")


def test_a_thousand_messages_of_theirs_come_whole_and_in_order(ours, theirs, types):
    ours.session.hear("many_theirs", SCAN)
    theirs.ask("advertise", name="/many_theirs", kind=SCAN)
    told = filled(theirs, SCAN)
    sent = [told | {"ranges": [float(number), 0.5]} for number in range(MANY)]
    theirs.ask("publish", name="/many_theirs", messages=sent)
    heard = ours.take(MANY)
    assert [plain(types.decode(SCAN, one.payload)) for one in heard] == sent
    numbers = [Attachment.decode(one.attachment).sequence for one in heard]
    assert numbers == list(range(numbers[0], numbers[0] + MANY))
    assert ours.session.dropped == 0


def test_a_thousand_messages_of_ours_come_whole_and_in_order(ours, theirs, types):
    theirs.ask("hear", name="/many_ours", kind=POSE)
    message = types.decode(POSE, bytes.fromhex(theirs.ask("serialized", kind=POSE, seed=1)["data"]))

    def numbered():
        for number in range(MANY):
            message.pose.pose.position.x = float(number)
            yield types.encode(POSE, message)

    for sent in ours.put("/many_ours", POSE, RELIABLE, numbered()):
        if sent % 50 == 0:  # no more at once than the network takes, which drops what is above that
            assert theirs.ask("count", name="/many_ours", least=sent) == sent
    heard = theirs.ask("heard", name="/many_ours", least=MANY)
    assert [one["pose"]["pose"]["position"]["x"] for one in heard] == list(range(MANY))
    assert heard[-1] == plain(message)


def test_who_comes_late_gets_what_is_latched(ours, endpoint, theirs, types):
    room = theirs.ask("serialized", kind=MAP, seed=1)
    data = bytes.fromhex(room["data"])
    ours.writer("/unlatched", MAP, RELIABLE).put(data, 1)
    _writer = ours.writer("/latched", MAP, LATCHED)
    _writer.put(data, 1)
    for name in ("/latched", "/unlatched"):
        theirs.ask("hear", name=name, kind=MAP, latched=True)
    assert theirs.ask("heard", name="/latched", least=1) == [room["told"]]
    assert theirs.ask("heard", name="/unlatched", least=1, within_s=0.2) == []
    with RobotSession.connect(endpoint, 0, "") as late:
        other = Ours(late, types)
        late.hear("*", MAP, latched=True)
        (found,) = other.take(1)
        assert (found.key, found.payload) == (Published("/latched", MAP, types.hash(MAP)).key(0), data)


def test_robots_whose_types_have_no_hashes_are_heard_and_answered(ours, theirs, types):
    ours.session.hear("humble", SCAN)
    theirs.ask("advertise", name="/humble", kind=SCAN, type_hash=NO_HASH)
    theirs.ask("publish", name="/humble", messages=[filled(theirs, SCAN)])
    (heard,) = ours.take(1)
    assert Published.parse(heard.key) == Published("/humble", SCAN, NO_HASH)

    theirs.ask("hear", name="/humble_pose", kind=POSE, type_hash=NO_HASH)
    data = bytes.fromhex(theirs.ask("serialized", kind=POSE, seed=1)["data"])
    assert list(ours.put("/humble_pose", POSE, RELIABLE, [data], NO_HASH)) == [1]
    assert theirs.ask("heard", name="/humble_pose", least=1) == [plain(types.decode(POSE, data))]


@pytest.mark.parametrize(
    ("topic", "attached", "reason"),
    [
        ("/bare", None, "an attachment of 0 bytes; expected the 33 of rmw_zenoh"),
        ("/old", b"\x0fsequence_number" + bytes(8) + b"\x10source_timestamp" + bytes(8), "before April 2025"),
    ],
)
def test_a_message_without_the_attachment_is_refused_counted_and_named(topic, attached, reason, ours, theirs, types):
    data = theirs.ask("serialized", kind=SCAN, seed=1)["data"]
    said = Said("robot")
    said.add(SCAN, Message(topic, 0, types.decode(SCAN, bytes.fromhex(data))))
    plan = planned(said, BagChoice(), Losses())
    reader = LiveReader(RobotPlan.of(plan, "odom", said.topics), types)
    ours.session.hear(topic.strip("/"), SCAN)
    theirs.ask("advertise", name=topic, kind=SCAN)
    for _ in range(2):
        theirs.ask("publish_raw", name=topic, data=data, attached=None if attached is None else attached.hex())
    for heard in ours.take(2):
        assert reader.take(heard).records == ()
    assert reader.refused == {topic: 2}
    (notice,) = reader.notices
    assert topic in notice
    assert reason in notice
