"""The node contract: the algorithm of a process as a pure, replayable state machine.

A node declares the topics that it reads and writes. A step takes a logical time and the consumed messages in order,
changes only the node's own state, and returns messages. It does no I/O, reads no clock, no environment and no global
random generator, and starts no threads. Its whole state can be saved and restored.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from dynpf_protocol.messages import Message

from dynpf.types import FloatArray

__all__ = [
    "Adopting",
    "Doubting",
    "Node",
    "Output",
    "Received",
    "Refusing",
    "Rehearsing",
    "Result",
    "Showing",
    "State",
    "Step",
    "Takeover",
    "decode_state",
    "encode_state",
    "state_digest",
]

State = Mapping[str, Any]
"""A node's whole state: text keys to None, bool, int, float, str, bytes, lists, dicts and NumPy arrays of these."""


class Received(NamedTuple):
    """One input: the message, its sender and its number."""

    topic: str
    node: str
    boot: str
    sequence: int
    stamp_ns: int
    message: Message


class Step(NamedTuple):
    """The arguments of a node's step: step number, tick, logical time in nanoseconds, and inputs in order."""

    number: int
    tick: int
    stamp_ns: int
    inputs: tuple[Received, ...]


class Output(NamedTuple):
    """One message for one topic."""

    topic: str
    message: Message


class Result(NamedTuple):
    """The result of a step. ``finished`` marks the last tick of the run; only the source's counts."""

    outputs: tuple[Output, ...] = ()
    finished: bool = False


class Node(Protocol):
    """A pure, replayable state machine.

    It names its topics as if it were the only one of its kind; its NodeSpec says what it reads and writes. A node built
    from the same scenario and restored by ``thaw`` continues exactly as the frozen one.
    """

    @property
    def name(self) -> str:
        """The node's name in the run."""

    def step(self, step: Step) -> Result:
        """Consume the step's inputs, change the state, and return messages."""

    def freeze(self) -> State:
        """Return the whole state."""

    def thaw(self, state: State) -> None:
        """Restore a state that ``freeze`` returned."""


@runtime_checkable
class Rehearsing(Protocol):
    """A node whose first step would be late because its kernels have to be compiled first."""

    def rehearse(self) -> None:
        """Call the kernels of a step once, on made-up data, so that they are compiled.

        Changes no state and no random stream. A host calls it before the node joins its run.
        """


@runtime_checkable
class Adopting(Protocol):
    """A node whose settings are partly in its state: ``thaw`` alone would leave a changed one without effect."""

    def adopt(self, state: State) -> None:
        """Go on from a state of a node with other settings; raises an exception if there is no way to."""


@runtime_checkable
class Refusing(Protocol):
    """A node of a simulated world that takes a person's acts, and not each of them."""

    def refuses(self, act: Message) -> str:
        """Return why an act cannot be done now, "" if it can. Changes no state."""


@runtime_checkable
class Doubting(Protocol):
    """A node that can tell, before a run, what of its settings is possible and still probably wrong."""

    def doubts(self) -> Sequence[str]:
        """Return a sentence for each."""


@runtime_checkable
class Showing(Protocol):
    """A node with particles, which can show more of them than it publishes."""

    def shown(self, most: int) -> FloatArray | None:
        """Return poses (3, M), M <= most, that represent the node's belief after its last step; None without one."""


class Takeover(Enum):
    """What becomes of the state of a snapshot in another process, or another run."""

    ITSELF = "the node goes on"
    OTHER = "a node with other settings goes on, and adopts it"
    FRESH = "the node begins in its first state; its host alone goes on"


_ARRAY = 1


def encode_state(state: State) -> bytes:
    """Return ``state`` as bytes. Equal states give equal bytes; arrays keep their type and shape.

    Every NaN is written with the same bits, because the sign of a computed NaN depends on the processor. Raises
    TypeError for values that no state may hold.
    """
    return _ENCODER.encode(_with_one_nan(state))


def decode_state(data: bytes) -> dict[str, Any]:
    """Return the state that ``encode_state`` encoded."""
    return _DECODER.decode(data)


def state_digest(state: State) -> str:
    """Return the SHA-256 of a state, in hexadecimal."""
    return hashlib.sha256(encode_state(state)).hexdigest()


def _with_one_nan(value: Any) -> Any:
    match value:
        case np.ndarray() | np.generic() if value.dtype.kind in "fc" and np.isnan(value).any():
            unified = np.array(value)
            unified[np.isnan(unified)] = np.nan
            return unified
        case float():
            return math.nan if math.isnan(value) else value
        case Mapping():
            return {key: _with_one_nan(inner) for key, inner in value.items()}
        case list() | tuple():
            return [_with_one_nan(inner) for inner in value]
    return value


def _encode_array(value: object) -> msgspec.msgpack.Ext:
    if not isinstance(value, np.ndarray | np.generic):
        raise TypeError(f"a node's state holds a {type(value).__name__}; expected plain values and NumPy arrays")
    array = np.ascontiguousarray(value)
    if array.dtype.kind in "OV":  # objects and structured types, whose bytes are no values
        raise TypeError(f"a node's state holds an array of {array.dtype}; expected numbers, truth values or text")
    header = msgspec.msgpack.encode((array.dtype.str, np.shape(value)))
    return msgspec.msgpack.Ext(_ARRAY, bytes([len(header)]) + header + array.tobytes())


def _decode_array(code: int, data: memoryview) -> object:
    if code != _ARRAY:
        raise ValueError(f"extension {code} in a node's state; expected {_ARRAY}")
    raw = bytes(data)
    end = 1 + raw[0]
    dtype, shape = msgspec.msgpack.decode(raw[1:end], type=tuple[str, tuple[int, ...]])
    return np.frombuffer(raw[end:], dtype=dtype).reshape(shape).copy()


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_encode_array, order="sorted")
_DECODER = msgspec.msgpack.Decoder(dict[str, Any], ext_hook=_decode_array)
