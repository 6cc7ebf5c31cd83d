"""Listening to a run in a process of its own, which does nothing else.

The router waits for who takes nothing, for a moment. So who executes nodes must not listen: what is heard waits in the
queue of this process, which is bounded, until it is taken; beyond that it is dropped, and the run goes on in any case.
"""

import multiprocessing
import os
import select
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal

import msgspec
from dynpf_protocol.errors import DynpfError
from dynpf_protocol.keys import RECORDED, RUN, SCENARIO

from dynpf_runtime.bus.keys import Credentials
from dynpf_runtime.bus.processes import may_fork
from dynpf_runtime.machines.events import Arrived, Dropped

__all__ = ["Frame", "Listener", "listening"]

_LOOK_S = 0.5
"""How often it looks whether the router, and who has started it, are there."""

_ENDED_S = 1.0
_MOST_AT_ONCE = 2**20


class Frame(msgspec.Struct, frozen=True, array_like=True):
    """What the listener hands on.

    ``scenario`` comes first, once it listens, with the router's scenario as payload; then what has ``arrived``. The
    last one says that messages were ``dropped``, that the router is ``gone``, or, as payload, why it ``failed``.
    """

    kind: Literal["scenario", "arrived", "dropped", "gone", "failed"]
    key: str = ""
    payload: bytes = b""
    attachment: bytes = b""


class Listener:
    """The end of the listening process at which what it hears is taken."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._received = bytearray()
        self._over = False
        self._decoder = msgspec.msgpack.Decoder(Frame)

    def take(self, timeout_s: float) -> Frame | None:
        """Return the next frame, None if none comes within ``timeout_s``, and ``gone`` if there are no more."""
        deadline_s = time.monotonic() + timeout_s
        while (content := self._whole()) is None:
            left_s = max(0.0, deadline_s - time.monotonic())
            if not self._over and not select.select([self._link], [], [], left_s)[0]:
                return None
            try:
                received = self._link.recv(_MOST_AT_ONCE)
            except OSError:
                received = b""
            if not received:
                self._over = True
                return Frame("gone")
            self._received += received
        return self._decoder.decode(content)

    def _whole(self) -> bytes | None:
        """Return the content of the next frame if all of it has come."""
        head = len(_length(0))
        if len(self._received) < head:
            return None
        end = head + int.from_bytes(self._received[:head], "little")
        if len(self._received) < end:
            return None
        content = bytes(self._received[head:end])
        del self._received[:end]
        return content


def _length(length: int) -> bytes:
    return length.to_bytes(8, "little")


@contextmanager
def listening(endpoint: str, keys: Credentials | None) -> Iterator[Listener]:
    """Listen to the run at ``endpoint`` in a process of its own, as long as the block lasts.

    It can be forked only from a process without threads, so it is started before anything else is.
    """
    context = multiprocessing.get_context("fork" if may_fork() else "spawn")
    here, there = socket.socketpair()
    arguments = there, here, endpoint, keys, os.getpid()
    process = context.Process(target=_listen, args=arguments, name="listener", daemon=True)  # type: ignore[attr-defined]
    process.start()
    there.close()
    try:
        yield Listener(here)
    finally:
        here.close()
        process.terminate()
        process.join(_ENDED_S)


def _listen(there: socket.socket, here: socket.socket, endpoint: str, keys: Credentials | None, parent: int) -> None:
    here.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who takes what it hears ends it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    encoder = msgspec.msgpack.Encoder()

    def hand_on(frame: Frame) -> None:
        content = encoder.encode(frame)
        there.sendall(_length(len(content)) + content)

    with suppress(OSError, KeyboardInterrupt):  # who has started it is gone
        try:
            for frame in _frames(endpoint, keys, parent):
                hand_on(frame)
        except DynpfError as error:
            hand_on(Frame("failed", payload=str(error).encode()))


def _frames(endpoint: str, keys: Credentials | None, parent: int) -> Iterator[Frame]:
    from dynpf_runtime.bus.session import Bus  # noqa: PLC0415 - it starts threads, and not in who is forked
    from dynpf_runtime.bus.terminal import say  # noqa: PLC0415

    def alone() -> bool:
        return os.getppid() != parent

    with Bus.connect(endpoint, lambda text: say("replay", text), alone, keys) as bus:
        bus.subscribe(f"{RUN}**")
        bus.subscribe(RECORDED)
        answer = None
        while answer is None and not alone() and bus.connected:
            answer = bus.ask(SCENARIO)
        yield Frame("scenario", payload=answer or b"")
        while not alone():
            heard = bus.receive(_LOOK_S)
            if type(heard) is Arrived:
                yield Frame("arrived", *heard)
            elif type(heard) is Dropped:
                yield Frame("dropped")
                return
            elif heard is None and not bus.connected:
                yield Frame("gone")
                return
