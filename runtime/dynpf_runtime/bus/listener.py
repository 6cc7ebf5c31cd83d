"""Listening to a run in a process of its own, which does nothing else.

The router waits for who takes nothing, for a moment. So who executes nodes must not listen: what is heard waits in the
queue of this process, which is bounded, until it is taken; beyond that it is dropped, and the run goes on in any case.
"""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
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

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._decoder = msgspec.msgpack.Decoder(Frame)

    def take(self, timeout_s: float) -> Frame | None:
        """Return the next frame, None after ``timeout_s``, and ``gone`` if there are no more."""
        try:
            if not self._connection.poll(timeout_s):
                return None
            return self._decoder.decode(self._connection.recv_bytes())
        except (EOFError, OSError):
            return Frame("gone")


@contextmanager
def listening(endpoint: str, keys: Credentials | None) -> Iterator[Listener]:
    """Listen to the run at ``endpoint`` in a process of its own, as long as the block lasts.

    It can be forked only from a process without threads, so it is started before anything else is.
    """
    context = multiprocessing.get_context("fork" if may_fork() else "spawn")
    here, there = context.Pipe(duplex=False)
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


def _listen(there: Connection, here: Connection, endpoint: str, keys: Credentials | None, parent: int) -> None:
    here.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who takes what it hears ends it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    encoder = msgspec.msgpack.Encoder()
    with suppress(BrokenPipeError, KeyboardInterrupt):
        try:
            for frame in _frames(endpoint, keys, parent):
                there.send_bytes(encoder.encode(frame))
        except DynpfError as error:
            there.send_bytes(encoder.encode(Frame("failed", payload=str(error).encode())))


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
