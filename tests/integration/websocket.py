"""A raw client of Foxglove's WebSocket protocol, foxglove.sdk.v1: it subscribes to every channel that is advertised."""

import base64
import json
import os
import socket
import struct
from typing import Any
from urllib.parse import urlsplit

__all__ = ["Viewer"]

PROTOCOL = "foxglove.sdk.v1"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10


class Viewer:
    """The connection of a viewer; ``channels`` are those advertised, by id, ``messages`` what came, by topic."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self._socket = socket.create_connection((parts.hostname, parts.port), timeout=20.0)
        key = base64.b64encode(os.urandom(16)).decode()
        asked = [f"GET / HTTP/1.1\r\nHost: {parts.netloc}", "Upgrade: websocket", "Connection: Upgrade"]
        asked += [f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", f"Sec-WebSocket-Protocol: {PROTOCOL}"]
        self._socket.sendall("\r\n".join([*asked, "", ""]).encode())
        self._stream = self._socket.makefile("rb")
        head = iter(self._stream.readline, b"\r\n")
        self.status = next(head).decode()
        self.agreed = PROTOCOL in [line.decode().partition(": ")[2].strip() for line in head]
        self.channels: dict[int, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}

    def take(self) -> None:
        """Take one frame; subscribe to the channels that it advertises."""
        first, second = self._stream.read(2)
        length = second & 127
        if length == 126:
            (length,) = struct.unpack(">H", self._stream.read(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._stream.read(8))
        content = self._stream.read(length)
        if first & 15 == PING:
            self._send(PONG, content)
        elif first & 15 == TEXT:
            self._told(json.loads(content))
        elif first & 15 == BINARY and content[0] == 1:
            channel, stamp = struct.unpack("<IQ", content[1:13])
            self.messages.setdefault(self.channels[channel]["topic"], []).append((stamp, content[13:]))

    def close(self) -> None:
        """Part."""
        self._stream.close()
        self._socket.close()

    def _told(self, message: dict[str, Any]) -> None:
        if message["op"] == "advertise":
            fresh = {channel["id"]: channel for channel in message["channels"]}
            self.channels |= fresh
            wanted = [{"id": channel, "channelId": channel} for channel in fresh]
            self._send(TEXT, json.dumps({"op": "subscribe", "subscriptions": wanted}).encode())

    def _send(self, kind: int, content: bytes) -> None:
        mask = os.urandom(4)
        length = bytes([128 | len(content)]) if len(content) < 126 else bytes([254]) + struct.pack(">H", len(content))
        masked = bytes(byte ^ mask[index % 4] for index, byte in enumerate(content))
        self._socket.sendall(bytes([128 | kind]) + length + mask + masked)
