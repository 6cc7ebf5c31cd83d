"""What a robot says as records, and estimates as what nav2_amcl would say."""

import math

import numpy as np
import pytest
from dynpf_formats.importers.bag_plan import BagChoice, planned
from dynpf_formats.importers.bags import Message
from dynpf_formats.importers.log import Losses
from dynpf_formats.importers.poses import compose
from dynpf_formats.importers.transforms import matrix, planar
from dynpf_formats.ros2.answers import TOLERANCE_NS, Answers
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import Published
from dynpf_formats.ros2.robot import CLOCK, IMU, INITIAL_POSE, Heard, LiveReader, RobotPlan, Said
from dynpf_formats.ros2.types import RosTypes
from dynpf_protocol.messages import Estimate, FilterHealth, HealthFigures, InitialPose, LaserScan, OdometryPose

TYPES = RosTypes()
SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
SECOND = 10**9
PUBLISHER = bytes(range(16))


def _header(frame, stamp_ns):
    stamp = TYPES.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, SECOND))
    return TYPES.make("std_msgs/msg/Header", stamp, frame)


def _scan(stamp_ns, ranges=(1.0, 2.0, math.inf)):
    values = np.array(ranges, np.float32)
    return TYPES.make(SCAN, _header("base", stamp_ns), -1.0, 1.0, 1.0, 0.0, 0.1, 0.1, 9.0, values, values[:0])


def _odometry(stamp_ns, x, theta):
    make = TYPES.make
    turned = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", x, 0.0, 0.0), turned)
    zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    twist = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36))
    content = make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    return make(ODOMETRY, _header("wheels", stamp_ns), "base", content, twist)


def _heard(topic, kind, message, sequence, arrival_ns):
    attachment = Attachment(sequence, arrival_ns, PUBLISHER).encode()
    return Heard(Published(topic, kind, TYPES.hash(kind)).key(0), TYPES.encode(kind, message), attachment, arrival_ns)


@pytest.fixture
def reader():
    return LiveReader(_plan(), TYPES)


def _plan():
    said = Said("tcp/robot:7447")
    said.add(SCAN, Message("/scan", 0, _scan(SECOND)))
    said.add(ODOMETRY, Message("/odom", 0, _odometry(SECOND, 0.0, 0.0)))
    plan = planned(said, BagChoice(), Losses())
    return RobotPlan.of(plan, said.odom_frame(plan), said.topics, "/bot1")


def test_scans_and_odometry_become_records_as_those_of_a_bag(reader):
    (pose,) = reader.take(_heard("/odom", ODOMETRY, _odometry(5 * SECOND, 2.0, 0.5), 1, 0)).records
    scanner, scan = reader.take(_heard("/scan", SCAN, _scan(5 * SECOND), 1, 0)).records
    (again,) = reader.take(_heard("/scan", SCAN, _scan(6 * SECOND), 2, SECOND)).records
    assert isinstance(pose.message, OdometryPose)
    assert (pose.topic, pose.message.x, round(pose.message.theta, 9)) == ("log/odometry_pose", 2.0, 0.5)
    assert (scanner.topic, scan.topic, scan.stamp_ns) == ("log/scanner", "log/scan", 5 * SECOND)
    assert isinstance(scan.message, LaserScan)
    assert scan.message.ranges == (1.0, 2.0, 9.0)  # infinity is no return
    assert again.topic == "log/scan"  # the scanner's limits have not changed
    assert reader.odometry_at(5 * SECOND) == pytest.approx((2.0, 0.0, 0.5))
    assert reader.odometry_at(4 * SECOND) is None


def test_lost_messages_are_told_with_the_records_topic(reader):
    reader.take(_heard("/scan", SCAN, _scan(SECOND), 1, 0))
    taken = reader.take(_heard("/scan", SCAN, _scan(2 * SECOND), 4, SECOND))
    assert [(topic, tuple(lost)) for topic, lost in taken.lost] == [("log/scan", (2, 3))]
    assert reader.lost == 2


def _told_pose(frame="map", x=1.0):
    make, covariance = TYPES.make, np.arange(36.0)
    turned = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.25), math.cos(0.25))
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", x, -2.0, 0.0), turned)
    content = make("geometry_msgs/msg/PoseWithCovariance", pose, covariance)
    return make(INITIAL_POSE, _header(frame, 0), content)


def test_a_pose_that_is_told_has_the_time_of_its_arrival(reader):
    told = _heard("/bot1/initialpose", INITIAL_POSE, _told_pose(), 1, 2 * SECOND)
    assert reader.take(told).records == ()  # nothing is known of the robot's time yet
    reader.take(_heard("/scan", SCAN, _scan(105 * SECOND), 1, 5 * SECOND))
    (record,) = reader.take(_heard("/bot1/initialpose", INITIAL_POSE, _told_pose(), 2, 6 * SECOND)).records
    message = record.message
    assert (record.topic, record.stamp_ns) == ("log/initial_pose", 106 * SECOND)
    assert isinstance(message, InitialPose)
    assert (message.x, message.y, message.theta) == pytest.approx((1.0, -2.0, 0.5))
    assert message.covariance == (0.0, 3.5, 17.5, 3.5, 7.0, 21.0, 17.5, 21.0, 35.0)  # the symmetric part


@pytest.mark.parametrize(("pose", "reason"), [(_told_pose("odom"), "expected map"), (_told_pose(x=math.nan), "finite")])
def test_a_pose_elsewhere_than_in_the_map_is_refused(pose, reason, reader):
    reader.take(_heard("/scan", SCAN, _scan(SECOND), 1, 0))
    assert reader.take(_heard("/bot1/initialpose", INITIAL_POSE, pose, 1, 0)).records == ()
    assert reason in reader.notices[0]


def _clock(stamp_ns):
    return TYPES.make(CLOCK, TYPES.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, SECOND)))


@pytest.mark.parametrize("has_clock", [True, False])
def test_the_clock_tells_how_fast_a_simulators_time_passes(has_clock, reader):
    """Scans come every half a second, ten times as fast as the robot's own time has it."""
    scans = []
    for tenth in range(50):
        if has_clock:
            reader.take(_heard("/clock", CLOCK, _clock(tenth * SECOND), tenth + 1, tenth * SECOND // 10))
        if tenth % 5 == 0:
            scan = _heard("/scan", SCAN, _scan(tenth * SECOND), tenth + 1, tenth * SECOND // 10)
            scans += [one.stamp_ns for one in reader.take(scan).records if one.topic == "log/scan"]
    whole = [tenth * SECOND for tenth in range(0, 50, 5)]
    assert (scans == whole) is has_clock


def _imu(stamp_ns, rate):
    make = TYPES.make
    zero, rates = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), make("geometry_msgs/msg/Vector3", 0.0, -rate, 0.0)
    level = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    return make(IMU, _header("imu", stamp_ns), level, np.zeros(9), rates, np.zeros(9), zero, np.zeros(9))


def test_odometry_turns_as_the_gyro_does_and_its_transform_as_the_wheels_do():
    reader = LiveReader(_plan().with_imu("/imu", (0.0, -1.0, 0.0)), TYPES)
    turned = []
    for step in range(11):
        at_ns = step * SECOND // 10
        assert reader.take(_heard("/imu", IMU, _imu(at_ns, 0.5), step + 1, at_ns)).records == ()
        (record,) = reader.take(_heard("/odom", ODOMETRY, _odometry(at_ns, 0.0, 0.1 * step), step + 1, at_ns)).records
        assert isinstance(record.message, OdometryPose)
        turned.append(record.message.theta)
    assert turned[-1] == pytest.approx(0.5)
    assert reader.odometry_at(SECOND) == pytest.approx((0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda heard: heard._replace(attachment=b""), "an attachment of 0 bytes"),
        (lambda heard: heard._replace(payload=heard.payload[:30]), "no sensor_msgs/msg/LaserScan"),
        (lambda heard: heard._replace(payload=b"\0\0" + heard.payload[2:]), "little endian"),
        (lambda heard: heard._replace(key="0/scan/rubbish/more"), "no key"),
        (lambda heard: heard._replace(key=heard.key.replace("/scan/", "/other/")), "is sensor_msgs"),
    ],
)
def test_what_is_no_message_of_the_robot_is_refused_counted_and_told(reader, change, reason):
    assert reader.take(change(_heard("/scan", SCAN, _scan(SECOND), 1, 0))) == ((), ())
    assert reader.refused.total() == 1
    assert reason in reader.notices[0]
    assert reader.take(_heard("/scan", SCAN, _scan(SECOND), 1, 0)).records  # the reader goes on


def _estimate(**fields):
    covariance = (0.04, 0.01, 0.002, 0.01, 0.09, 0.003, 0.002, 0.003, 0.01)
    return Estimate(x=3.0, y=-1.0, theta=2.0, covariance=covariance, n_eff=100.0, **fields)


def _sent(kind, message):
    return TYPES.decode(kind, TYPES.encode(kind, message))


def test_the_pose_has_the_covariance_of_x_y_and_heading():
    answers = Answers(TYPES, ("map", "odom"), "localization")
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    found = _sent(kind, answers.pose(_estimate(), 7 * SECOND + 5))
    assert (found.header.frame_id, found.header.stamp.sec, found.header.stamp.nanosec) == ("map", 7, 5)
    covariance = found.pose.covariance.reshape(6, 6)
    assert covariance[0, 1] == 0.01
    assert covariance[5, 1] == 0.003
    assert np.count_nonzero(covariance) == 9


def test_odometry_by_the_transform_gives_the_estimate_and_is_dated_ahead():
    answers, odometry = Answers(TYPES, ("map", "odom"), "localization"), (0.7, 0.2, -0.4)
    (found,) = _sent("tf2_msgs/msg/TFMessage", answers.transform(_estimate(), odometry, 7 * SECOND)).transforms
    assert (found.header.frame_id, found.child_frame_id) == ("map", "odom")
    assert found.header.stamp.sec * SECOND + found.header.stamp.nanosec == 7 * SECOND + TOLERANCE_NS
    transform = matrix(found.transform.translation, found.transform.rotation)
    assert transform is not None
    assert compose(planar(transform), odometry) == pytest.approx((3.0, -1.0, 2.0))


def test_a_lost_filter_is_an_error_in_the_diagnostics():
    health = FilterHealth(status="lost", reason="no beam fits", figures=HealthFigures(n_eff_share=0.5))
    answers = Answers(TYPES, ("map", "odom"), "localization/bot1")
    message = answers.diagnostics(_estimate(health=health), 3, 1, SECOND)
    (status,) = _sent("diagnostic_msgs/msg/DiagnosticArray", message).status
    assert (status.level, status.name, status.message) == (2, "localization/bot1", "lost: no beam fits")
    assert {pair.key: pair.value for pair in status.values}["messages_lost"] == "3"
