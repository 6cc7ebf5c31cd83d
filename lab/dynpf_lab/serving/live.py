"""A run that goes on, by the WebSocket protocol of Foxglove's SDK: what is heard on the bus, as its viewers read it.

The SDK sends to each viewer from a bounded queue of its own, so that a slow one misses messages and holds nobody up.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping

import foxglove
import foxglove.websocket
from dynpf_experiments.viewers.foxglove import encoded, schema_of
from dynpf_experiments.viewers.items import FIGURES, STATUSES, Item, Number, Passing, Plain
from dynpf_formats.recording.stream import RecordedSchema
from dynpf_formats.shipped import known_topics
from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.errors import ProtocolError
from dynpf_protocol.keys import DATA, topic_of
from dynpf_protocol.messages import Estimate, Message, Scanner
from dynpf_protocol.schemas import json_schema
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_protocol.topics import Topic
from dynpf_runtime.bus.listener import Listener

__all__ = ["LiveRun"]

STATE = "/state"
_LOOK_S = 0.5


class _Newcomers(foxglove.websocket.ServerListener):
    """Notes the topics to which a viewer has just subscribed; the SDK calls it from threads of its own."""

    def __init__(self) -> None:
        self.topics: deque[str] = deque(maxlen=1000)

    def on_subscribe(self, _client: foxglove.websocket.Client, channel: foxglove.websocket.ChannelView) -> None:
        """Note the channel's topic."""
        self.topics.append(channel.topic)


class LiveRun:
    """Channels of a server on loopback, on a free port, that grow with the topics that are heard."""

    def __init__(self) -> None:
        self._topics: Mapping[str, Topic] = known_topics()
        self._context = foxglove.Context()
        self._newcomers = _Newcomers()
        self._server = foxglove.start_server(
            name="dynpf", host="127.0.0.1", port=0, context=self._context, server_listener=self._newcomers
        )
        self._stays: dict[str, Item] = {}
        self._channels: dict[str, foxglove.Channel] = {}
        self._poses: dict[str, tuple[float, float, float]] = {}
        self._greatest: dict[str, float] = {}
        self._passing = Passing(
            self._topics, lambda robot, _: self._poses.get(robot), lambda node: self._greatest.get(node, math.inf)
        )

    @property
    def address(self) -> str:
        """Where viewers find it."""
        return f"ws://127.0.0.1:{self._server.port}"

    def show(self, shown: Iterable[Item]) -> None:
        """Send items to all viewers."""
        for item in shown:
            channel = self._channels.get(item.topic)
            if channel is None:
                channel = self._channels[item.topic] = self._channel(item)
            channel.log(encoded(item), log_time=item.stamp_ns)

    def show_always(self, shown: Iterable[Item]) -> None:
        """Send what does not change, such as the map, to all viewers, and to each that comes later."""
        for item in shown:
            self._stays[item.topic] = item
            self.show([item])

    def _welcome(self) -> None:
        """Send what does not change to those who have come."""
        while self._newcomers.topics:
            item = self._stays.get(self._newcomers.topics.popleft())
            self.show([] if item is None else [item])

    def follow(self, listener: Listener, going: Callable[[], bool]) -> str:
        """Pass on what is heard until the run or ``going`` ends; return why it is over."""
        while going():
            self._welcome()
            frame = listener.take(_LOOK_S)
            if frame is None:
                continue
            if frame.kind in ("gone", "dropped", "failed"):
                return frame.payload.decode(errors="replace") or frame.kind
            if frame.kind == "arrived" and frame.key.startswith(DATA):
                self.show(self.heard(frame.key, frame.payload, frame.attachment))
        return "stopped"

    def heard(self, key: str, payload: bytes, attachment: bytes) -> list[Item]:
        """Return what is shown of a message of the bus; nothing of what cannot be read."""
        topic, _ = topic_of(key)
        row = self._topics.get(topic)
        if topic.startswith(SNAPSHOT_PREFIX):
            return []
        try:
            stamp_ns = decode_envelope(attachment).stamp_ns
            message = None if row is None else decode(topic, payload, self._topics)
        except ProtocolError:
            return []
        schema = None if row is None else RecordedSchema(row.type.schema_name, json_schema(row.type))
        found = list(self._passing.items(topic, stamp_ns, Plain(payload, schema), message))
        return found + self._learn(topic, stamp_ns, message)

    def close(self) -> None:
        """Part from all viewers."""
        self._server.stop()

    def _learn(self, topic: str, stamp_ns: int, message: Message | None) -> list[Item]:
        """Note what later messages are placed by, and return a filter's verdict as a number."""
        node = topic.rpartition("/")[0]
        match message:
            case Scanner(range_max=range_max):
                self._greatest[node] = range_max
            case Estimate() if topic.endswith(STATE):
                self._poses[node.rpartition("/")[0]] = (message.x, message.y, message.theta)
                if message.health:
                    status = message.health.status
                    level = STATUSES.index(status) if status in STATUSES else -1
                    shown = Number(float(level), f"{status}: {message.health.reason}")
                    return [Item(f"{FIGURES}/health/{node}", stamp_ns, shown)]
        return []

    def _channel(self, item: Item) -> foxglove.Channel:
        encoding, name, schema_encoding, data = schema_of(item)
        schema = foxglove.Schema(name=name, encoding=schema_encoding, data=data)
        return foxglove.Channel(item.topic, schema=schema, message_encoding=encoding, context=self._context)
