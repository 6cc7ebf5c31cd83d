"""The other side of the tests of ROS 2: `python -I other_side.py FOLDER`, in the environment that `make ros2` makes.

Reads a JSON document a line, {"ask": NAME, ...}, and prints {"answer": ...}, or {"error": ...}; a function here is
named as the question that it answers. Messages are told as {field: value}. Hashes and CDR are those of ROS 2 itself,
keys, tokens, attachments and quality of service those of zenoh-ros2-sdk. Nothing of dynpf takes part.
"""

import dataclasses
import json
import random
import sys
import threading
import time
import traceback
from collections import defaultdict
from pathlib import Path
from typing import Any

SHARE = Path(sys.prefix) / "share"
FOLDER = Path(sys.argv[1])
# Packages of which there are no wheels, as the SDK reads them.
FURTHER = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight\n",
    "nav2_msgs/msg/ParticleCloud": "std_msgs/Header header\nParticle[] particles\n",
}


_nodes: list[Any] = []
_publishers: dict[str, Any] = {}
_subscribers: dict[str, Any] = {}
_heard: defaultdict[str, list[Any]] = defaultdict(list)
_came = threading.Condition()


def _come(name, message):
    with _came:
        _heard[name].append(message)
        _came.notify_all()


# --- ROS 2 itself


def _class_of(kind):
    import builtin_interfaces.msg
    import diagnostic_msgs.msg
    import geometry_msgs.msg
    import nav_msgs.msg
    import rosgraph_msgs.msg
    import sensor_msgs.msg
    import std_msgs.msg

    packages = builtin_interfaces, diagnostic_msgs, geometry_msgs, nav_msgs, rosgraph_msgs, sensor_msgs, std_msgs
    named, _, name = kind.split("/")
    return next(getattr(package.msg, name) for package in packages if package.__name__ == named)


def _fields(message):
    """Return the names of the fields of a message of the SDK's; what is capital is a constant."""
    return [field.name for field in dataclasses.fields(message) if field.name[0].islower()]


def _plain(value):
    """Return a message or a value of either library as JSON has it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if dataclasses.is_dataclass(value):
        return {name: _plain(getattr(value, name)) for name in _fields(value)}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, str):
        return value
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "__len__"):
        return [_plain(one) for one in value]
    return value


def hashes(kinds):
    """Return the hashes of types in the packages of ROS 2."""
    found: dict[str, str] = {}
    for kind in kinds:
        told = json.loads((SHARE / f"{kind}.json").read_text())["type_hashes"]
        found |= {one["type_name"]: one["hash_string"] for one in told if one["type_name"] == kind}
    return found


def generated_hashes(package, idl):
    """Return the hashes that ROS 2's own generator gives types of a package, from their IDL, {name: text}."""
    from rosidl_generator_type_description import generate_type_hash

    folder = FOLDER / "idl"
    (folder / "msg").mkdir(parents=True, exist_ok=True)
    for name, text in idl.items():
        (folder / "msg" / f"{name}.idl").write_text(text)
    packages = ("builtin_interfaces", "geometry_msgs", "std_msgs")
    arguments = {
        "package_name": package,
        "output_dir": str(folder / package),
        "idl_tuples": [f"{folder}:msg/{name}.idl" for name in idl],
        "include_paths": [f"{name}:{SHARE / name}" for name in packages],
    }
    (folder / "arguments.json").write_text(json.dumps(arguments))
    generate_type_hash(str(folder / "arguments.json"))
    return {
        one["type_name"]: one["hash_string"]
        for name in idl
        for one in json.loads((folder / package / "msg" / f"{name}.json").read_text())["type_hashes"]
        if one["type_name"].startswith(f"{package}/")
    }


def _fill(message, draw):
    """Set every field of a message to something, at random."""
    for name, kind in message.get_fields_and_field_types().items():
        inner, many = kind, None
        if kind.startswith("sequence<"):
            inner, many = kind[len("sequence<") : -1].partition(",")[0], draw.randrange(4)
        elif kind.endswith("]"):
            inner, _, size = kind[:-1].partition("[")
            many = int(size)
        values = [_value(inner, draw) for _ in range(1 if many is None else many)]
        setattr(message, name, values[0] if many is None else values)


def _value(kind, draw):
    if "/" in kind:
        package, name = kind.split("/")
        message = _class_of(f"{package}/msg/{name}")()
        _fill(message, draw)
        return message
    if kind == "string":
        return draw.choice(("", "base", "map/ü"))
    if kind in {"float", "double"}:
        return draw.choice((0.0, -1.5, 0.25, 1e9, float("inf")))
    if kind == "boolean":
        return draw.random() < 0.5
    if kind == "octet":
        return bytes([draw.randrange(128)])  # rosbags takes it for signed
    bits = int("".join(letter for letter in kind if letter.isdigit()))
    return draw.randrange(2**bits) if kind.startswith("u") else draw.randrange(-(2 ** (bits - 1)), 2 ** (bits - 1))


def serialized(kind, seed):
    """Return a message with something in every field, as bytes by rclpy and as told."""
    from rclpy.serialization import serialize_message

    message = _class_of(kind)()
    _fill(message, random.Random(f"{kind}{seed}"))
    return {"data": serialize_message(message).hex(), "told": _plain(message)}


def deserialized(kind, data):
    """Return what rclpy reads from bytes."""
    from rclpy.serialization import deserialize_message

    return _plain(deserialize_message(bytes.fromhex(data), _class_of(kind)))


def xxh3(text):
    """Return 16 bytes: the low half of XXH3-128, then the high one, least byte first."""
    import xxhash

    number = xxhash.xxh3_128_intdigest(text.encode())
    return number.to_bytes(16, "little").hex()


# --- a node of ROS 2, on DDS


def node(domain):
    """Become a node of rclpy in a domain, which is spun in a thread."""
    import rclpy

    rclpy.init(domain_id=domain)
    _nodes.append(rclpy.create_node("robot"))
    threading.Thread(target=rclpy.spin, args=(_nodes[0],), daemon=True).start()


def _latched_or_not(latched):
    from rclpy.qos import DurabilityPolicy, QoSProfile

    volatile, local = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(depth=1 if latched else 10, durability=local if latched else volatile)


def node_hears(name, kind, latched=False):
    """Subscribe a topic by rclpy."""
    _nodes[0].create_subscription(_class_of(kind), name, lambda message: _come(name, message), _latched_or_not(latched))


def node_latches(name, kind, told):
    """Publish a message by rclpy for whoever comes."""
    publisher = _nodes[0].create_publisher(_class_of(kind), name, _latched_or_not(True))
    publisher.publish(_set(_class_of(kind)(), told))
    _publishers[name] = publisher


def node_repeats(messages, every_s):
    """Publish messages by rclpy again and again, {topic: [type, message]}, with the time of now, until the end."""
    from rclpy.qos import qos_profile_sensor_data

    for name, (kind, told) in messages.items():
        publisher = _nodes[0].create_publisher(_class_of(kind), name, qos_profile_sensor_data)
        _publishers[name] = publisher, _set(_class_of(kind)(), told)

    def repeat():
        while True:
            for name in messages:
                publisher, message = _publishers[name]
                message.header.stamp = _nodes[0].get_clock().now().to_msg()
                publisher.publish(message)
            time.sleep(every_s)

    threading.Thread(target=repeat, daemon=True).start()


def node_publishes(name, kind, told):
    """Publish a message by rclpy, once somebody hears it."""
    publisher = _nodes[0].create_publisher(_class_of(kind), name, 10)
    ends = time.monotonic() + 20.0
    while not publisher.get_subscription_count() and time.monotonic() < ends:
        time.sleep(0.02)
    publisher.publish(_set(_class_of(kind)(), told))
    _publishers[name] = publisher


def _set(message, told):
    """Set the fields of a message of ROS 2's."""
    for name, value in told.items():
        field = getattr(message, name)
        setattr(message, name, _set(field, value) if hasattr(field, "get_fields_and_field_types") else value)
    return message


# --- zenoh-ros2-sdk


def _registered():
    """Let the SDK read definitions from here, not from the network."""
    from zenoh_ros2_sdk.message_registry import get_registry

    folder = FOLDER / "messages"
    folder.mkdir(exist_ok=True)
    for package in SHARE.iterdir():
        if (package / "msg").is_dir():
            (folder / package.name).symlink_to(package)
    for kind, text in FURTHER.items():
        path = folder / f"{kind}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return get_registry(str(folder))


def join(port):
    """Join the router at a port of this machine, as the SDK does."""
    from zenoh_ros2_sdk.session import ZenohSession

    session = ZenohSession.get_instance("127.0.0.1", port)
    _registered()
    return session.session_id


def computed_hash(kind):
    """Return the hash that the SDK computes for a type, by a parser of its own."""
    from zenoh_ros2_sdk.message_registry import get_registry
    from zenoh_ros2_sdk.utils import get_type_hash, load_dependencies_recursive

    registry = get_registry()
    text = registry.get_msg_file_path(kind).read_text()
    return get_type_hash(kind, text, load_dependencies_recursive(kind, text, registry))


def topics():
    """Return the topics and their types, as `ros2 topic list -t`."""
    from zenoh_ros2_sdk.discovery import get_topic_names_and_types

    return dict(get_topic_names_and_types(timeout=2.0))


def topic(name):
    """Return who publishes and hears a topic, as `ros2 topic info -v`; the quality of service as it is understood."""
    from zenoh_ros2_sdk.discovery import get_topic_info

    info = get_topic_info(name, timeout=2.0, verbose=True)
    found: dict[str, list[Any]] = {"publishers": [], "subscribers": []}
    for side, ends in found.items():
        for end in getattr(info, side) if info is not None else ():
            told = {
                "node": end.node_name,
                "namespace": end.node_namespace,
                "type": end.topic_type,
                "hash": end.type_hash,
            }
            ends.append(told | {"qos": quality(end.qos)})
    return found


def quality(text):
    """Return reliability, durability and depth of a token's field."""
    from zenoh_ros2_sdk.qos import QosProfile

    profile = QosProfile.decode(text)
    return [profile.reliability.name, profile.durability.name, profile.history_depth]


def attachment(data):
    """Return number, time and publisher of an attachment."""
    from zenoh_ros2_sdk.attachment import Attachment

    read = Attachment.from_bytes(bytes.fromhex(data))
    return [read.sequence_id, read.timestamp_ns, read.gid.hex()]


def hear(name, kind, latched=False, type_hash=None):
    """Subscribe a topic, as `ros2 topic echo`."""
    from zenoh_ros2_sdk import ROS2Subscriber
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile

    qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1) if latched else None
    _subscribers[name] = ROS2Subscriber(name, kind, lambda message: _come(name, message), qos=qos, type_hash=type_hash)


def count(name, least, within_s=20.0):
    """Wait until so many messages have come on a topic; return how many have."""
    with _came:
        _came.wait_for(lambda: len(_heard[name]) >= least, within_s)
        return len(_heard[name])


def heard(name, least, within_s=20.0):
    """Wait until so many messages have come on a topic; return all that have."""
    count(name, least, within_s)
    return [_plain(message) for message in _heard[name]]


def advertise(name, kind, type_hash=None):
    """Become a publisher of a topic."""
    from zenoh_ros2_sdk import ROS2Publisher

    _publishers[name] = ROS2Publisher(name, kind, type_hash=type_hash)


def _made(store, kind, told):
    """Return a message of the SDK's."""
    from rosbags.interfaces import Nodetype

    values = {}
    for name, (node, inner) in store.fielddefs[kind][1]:
        value = told[name]
        if node == Nodetype.NAME:
            value = _made(store, inner, value)
        elif node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
            (element, detail), _ = inner
            if element == Nodetype.NAME:
                value = [_made(store, detail, one) for one in value]
            else:
                import numpy as np

                value = np.array(value, detail[0])
        values[name] = value
    return store.types[kind](**values)


def _wanted(name):
    """Return the publisher of a topic, once somebody hears it."""
    publisher = _publishers[name]
    wanted = threading.Event()
    listener = publisher.pub.declare_matching_listener(lambda status: wanted.set() if status.matching else None)
    if not publisher.pub.matching_status.matching and not wanted.wait(20.0):
        raise TimeoutError(f"nobody hears {name}")
    listener.undeclare()
    return publisher


def publish(name, messages):
    """Publish messages on a topic, once somebody hears it."""
    _wanted(name)
    for told in messages:
        _publish(name, told)


def _publish(name, told):
    publisher = _publishers[name]
    message = _made(publisher.session_mgr.store, publisher.msg_type, told)
    publisher.publish(**{field: getattr(message, field) for field in _fields(message)})


def publish_raw(name, data, attached):
    """Put bytes on the key of a topic, with another attachment than the SDK's, or none."""
    _publishers[name].pub.put(
        bytes.fromhex(data), **({} if attached is None else {"attachment": bytes.fromhex(attached)})
    )


_go = threading.Event()


def play(path, first_s, rate):
    """Publish the messages of a file in a thread, ``rate`` times as fast as they were.

    A line is [s from the beginning, topic, message]. The first of each topic is repeated until all shall ``go``.
    Stamps begin with ``first_s`` and go on at that rate.
    """
    with Path(path).open() as lines:
        messages = [json.loads(line) for line in lines]
    threading.Thread(target=_play, args=(messages, first_s, rate), daemon=True).start()


def go():
    """Let the robot of the file go."""
    _go.set()


def _play(messages, first_s, rate):
    began = time.monotonic()
    first = {name: told for _, name, told in reversed(messages)}
    while not _go.wait(0.1):
        for name, told in first.items():
            _publish(name, _dated(told, first_s + (time.monotonic() - began) * rate))
    stood_s = (time.monotonic() - began) * rate
    for at_s, name, told in messages:
        if (wait_s := began + (stood_s + at_s) / rate - time.monotonic()) > 0.0:
            time.sleep(wait_s)
        _publish(name, _dated(told, first_s + stood_s + at_s))
    _come("played", stood_s)


def _dated(told, stamp_s):
    seconds, nanoseconds = divmod(round(stamp_s * 1e9), 10**9)
    return told | {"header": told["header"] | {"stamp": {"sec": seconds, "nanosec": nanoseconds}}}


def main():
    """Answer until stdin ends."""
    for line in sys.stdin:
        question = json.loads(line)
        try:
            answer = json.dumps({"answer": globals()[question.pop("ask")](**question)})
        except Exception:
            answer = json.dumps({"error": traceback.format_exc()})
        print(answer, flush=True)


if __name__ == "__main__":
    main()
