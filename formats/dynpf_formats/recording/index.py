"""The index of a recording's messages, arrays of some tens of bytes per message; payloads are fetched on demand.

A message's position is its index in the order of the file.
"""

import os
import tempfile
import weakref
from array import array
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, overload

import numpy as np

from dynpf_formats.recording.errors import CorruptRecordingError
from dynpf_formats.recording.mcap_records import Region, unpack
from dynpf_formats.recording.stream import Source, StreamedMessage
from dynpf_formats.regular_files import open_regular

__all__ = ["MessageIndex", "Positions", "Recorded", "Records"]

_CACHE_BYTES = 64 * 2**20
_UNPACKED_AGAIN = 2 * _CACHE_BYTES  # bytes of chunks, until those that are unpacked again are kept in a file
_LARGEST_SCRATCH = 2**30  # bytes of that file


class _Payloads:
    """Payloads by chunk: the most recently used chunks stay in memory, uncompressed, up to _CACHE_BYTES.

    Whose messages alternate between more chunks than these would unpack one for each message. Chunks that are often
    unpacked again are therefore written uncompressed to a temporary file, if the system has room for it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offsets = array("Q")
        self._lengths = array("Q")
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._cached = 0
        self._again = 0  # bytes unpacked again
        self._newest = -1, b""  # the chunk used last, and its number: messages are mostly asked for in their order
        self._scratch: IO[bytes] | None = None
        self._scratch_size = 0
        self._written: dict[int, tuple[int, int]] = {}  # where a chunk begins in the temporary file, and its size
        self._asked = -1  # the chunk of the last payload that was read from there

    def add(self, region: Region) -> int:
        """Add a chunk that has just been read; return its number."""
        self._offsets.append(region.offset)
        self._lengths.append(region.length)
        self._keep(len(self._offsets) - 1, region.data)
        return len(self._offsets) - 1

    def get(self, chunk: int, start: int, stop: int) -> bytes:
        """Return bytes of a chunk by its number; raises CorruptRecordingError if the file has changed."""
        newest, data = self._newest
        if newest == chunk:
            return data[start:stop]
        return self._of(chunk, start, stop)

    def _of(self, chunk: int, start: int, stop: int) -> bytes:
        data = self._cache.get(chunk)
        if data is not None:
            self._cache.move_to_end(chunk)
        elif self._scratch is not None and chunk in self._written:
            begin, size = self._written[chunk]
            if chunk != self._asked:
                self._asked = chunk
                return os.pread(self._scratch.fileno(), stop - start, begin + start)
            data = os.pread(self._scratch.fileno(), size, begin)  # they are asked for in their order
            self._keep(chunk, data)
        else:
            data = self._fetch(chunk)
            self._keep(chunk, data)
            self._again += len(data)
            if self._again > _UNPACKED_AGAIN:
                self._write(chunk, data)
        self._newest = chunk, data
        return data[start:stop]

    def _write(self, chunk: int, data: bytes) -> None:
        if self._scratch_size + len(data) > _LARGEST_SCRATCH:
            return
        try:
            if self._scratch is None:
                self._scratch = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the index
                weakref.finalize(self, self._scratch.close)
            self._scratch.seek(self._scratch_size)
            self._scratch.write(data)
            self._scratch.flush()
        except OSError:
            return  # no room: the chunk is unpacked again when it is needed
        self._written[chunk] = self._scratch_size, len(data)
        self._scratch_size += len(data)

    def _keep(self, chunk: int, data: bytes) -> None:
        self._cache[chunk] = data
        self._cached += len(data)
        while self._cached > _CACHE_BYTES and len(self._cache) > 1:
            self._cached -= len(self._cache.popitem(last=False)[1])

    def _fetch(self, chunk: int) -> bytes:
        try:
            with open_regular(self._path) as stream:
                stream.seek(self._offsets[chunk])
                return unpack(stream.read(self._lengths[chunk]))
        except (OSError, ValueError) as error:
            raise CorruptRecordingError(f"{self._path}: changed while it was in use: {error}") from error


class Positions:
    """The positions of one source's messages by sequence number, each number once."""

    def __init__(self, positions: "array[int]", sequences: "array[int]", begin: int, end: int) -> None:
        self._positions = positions
        self._sequences = sequences
        self._begin = begin
        self._end = end

    def __len__(self) -> int:
        return self._end - self._begin

    def __getitem__(self, number: int) -> int:
        return self._positions[range(self._begin, self._end)[number]]

    def find(self, sequence: int) -> int | None:
        """Return the position of the message with a sequence number, or None."""
        place = self._begin + sequence
        if place < self._end and self._sequences[position := self._positions[place]] == sequence:
            return position  # no earlier one is missing
        number = bisect_left(range(len(self)), sequence, key=lambda number: self._sequences[self[number]])
        found = number < len(self) and self._sequences[self[number]] == sequence
        return self[number] if found else None


class MessageIndex:
    """All recorded messages, with journal entries and repetitions, in the order of the file.

    ``chunk`` and ``add`` fill it; it is ready to use after ``close``.
    """

    def __init__(self, path: Path) -> None:
        self._payloads = _Payloads(path)
        self._channels = array("H")
        self.sequences = array("I")
        self.stamps_ns = array("Q")
        self.publish_ns = array("Q")
        self._chunks = array("I")
        self._starts = array("I")
        self._stops = array("I")
        self.sources: tuple[Source, ...] = ()
        self._numbers = array("H")
        self._by_source: dict[tuple[str, str, str], Positions] = {}
        self._is_first = b""
        self._chunk = 0

    def __len__(self) -> int:
        return len(self.sequences)

    def chunk(self, region: Region) -> None:
        """Add the chunk that holds the next messages."""
        self._chunk = self._payloads.add(region)

    def add(self, message: StreamedMessage) -> None:
        """Append a message of the current chunk."""
        self._channels.append(message.channel)
        self.sequences.append(message.sequence)
        self.stamps_ns.append(message.stamp_ns)
        self.publish_ns.append(message.publish_ns)
        self._chunks.append(self._chunk)
        self._starts.append(message.start)
        self._stops.append(message.stop)

    def close(self, described: Mapping[int, Source]) -> None:
        """Assign sources to channels, drop messages on channels without one, and sort by source and sequence number."""
        known = np.zeros(2**16, bool)
        known[list(described)] = True
        keep = known[np.asarray(self._channels)]
        if not keep.all():
            for name in ("_channels", "sequences", "stamps_ns", "publish_ns", "_chunks", "_starts", "_stops"):
                setattr(self, name, _array(np.asarray(getattr(self, name))[keep]))
        channels, first = np.unique(np.asarray(self._channels), return_index=True)
        self.sources = tuple(dict.fromkeys(described[channel] for channel in channels[np.argsort(first)].tolist()))
        numbers = {source: number for number, source in enumerate(self.sources)}
        number_of = np.zeros(2**16, np.uint16)
        for channel in channels.tolist():
            number_of[channel] = numbers[described[channel]]
        number = number_of[np.asarray(self._channels)]
        self._channels = array("H")
        self._numbers = _array(number)
        self._sort(number)

    def _sort(self, number: "np.ndarray[tuple[int], np.dtype[np.uint16]]") -> None:
        sequences = np.asarray(self.sequences)
        order = np.lexsort((sequences, number)).astype(np.uint32)  # stable: a repetition follows the first
        by_number, by_sequence = number[order], sequences[order]
        is_new = np.ones(len(order), bool)
        is_new[1:] = (by_number[1:] != by_number[:-1]) | (by_sequence[1:] != by_sequence[:-1])
        order, by_number = order[is_new], by_number[is_new]
        is_first = np.zeros(len(number), bool)
        is_first[order] = True
        self._is_first = is_first.tobytes()
        bounds = np.searchsorted(by_number, np.arange(len(self.sources) + 1)).tolist()
        positions = _array(order)
        self._by_source = {
            source: Positions(positions, self.sequences, begin, end)
            for source, begin, end in zip(self.sources, bounds[:-1], bounds[1:], strict=True)
        }

    def source(self, position: int) -> Source:
        """Return the source of the message at a position."""
        return self.sources[self._numbers[position]]

    def size(self, position: int) -> int:
        """Return the length of a payload in bytes."""
        return self._stops[position] - self._starts[position]

    def payload(self, position: int) -> bytes:
        """Return the payload at a position, read from the file if it is not in memory."""
        return self._payloads.get(self._chunks[position], self._starts[position], self._stops[position])

    def find(self, source: tuple[str, str, str], sequence: int) -> int | None:
        """Return the position of the first message with this sequence number, or None if it was not recorded.

        ``source`` has topic, node and boot, as a Source does.
        """
        positions = self._by_source.get(source)
        return None if positions is None else positions.find(sequence)

    def is_first(self, position: int) -> bool:
        """Return whether no earlier message has the same source and sequence number."""
        return bool(self._is_first[position])

    def of(self, source: Source) -> "Records":
        """Return the messages of a source by sequence number, each number once."""
        return Records(self, self._by_source.get(source, ()))

    def all(self) -> "Records":
        """Return all messages in the order of the file."""
        return Records(self, range(len(self)))

    def rows(self) -> "Iterator[tuple[Source, int, int, int, bytes]]":
        """Yield source, sequence number, logical and publish time, and payload of each message in the file's order."""
        sources, get = self.sources, self._payloads.get
        columns = zip(
            self._numbers,
            self.sequences,
            self.stamps_ns,
            self.publish_ns,
            zip(self._chunks, self._starts, self._stops, strict=True),
            strict=True,
        )
        for number, sequence, stamp_ns, publish_ns, place in columns:
            yield sources[number], sequence, stamp_ns, publish_ns, get(*place)

    def repeated(self) -> Iterator[int]:
        """Yield the positions of messages that have the source and sequence number of an earlier one."""
        position = self._is_first.find(0)
        while position >= 0:
            yield position
            position = self._is_first.find(0, position + 1)

    def firsts(self, wanted: Sequence[bool]) -> Iterator[int]:
        """Yield the positions of messages that are no repetitions; ``wanted`` selects sources by their number."""
        for position, (number, first) in enumerate(zip(self._numbers, self._is_first, strict=True)):
            if first and wanted[number]:
                yield position


class Recorded:
    """One recorded message; its ``payload`` is read from the file on demand."""

    __slots__ = ("_index", "position")

    def __init__(self, index: MessageIndex, position: int) -> None:
        self._index = index
        self.position = position

    @property
    def source(self) -> Source:
        """Topic, node and boot."""
        return self._index.source(self.position)

    @property
    def topic(self) -> str:
        """The topic's name."""
        return self.source.topic

    @property
    def node(self) -> str:
        """The sending node."""
        return self.source.node

    @property
    def boot(self) -> str:
        """The start of the sending node's process."""
        return self.source.boot

    @property
    def sequence(self) -> int:
        """The sequence number within the source."""
        return self._index.sequences[self.position]

    @property
    def stamp_ns(self) -> int:
        """Logical time, ns."""
        return self._index.stamps_ns[self.position]

    @property
    def publish_ns(self) -> int:
        """Time of publishing by the sender's clock, ns."""
        return self._index.publish_ns[self.position]

    @property
    def size(self) -> int:
        """Length of the payload in bytes."""
        return self._index.size(self.position)

    @property
    def payload(self) -> bytes:
        """The encoded message."""
        return self._index.payload(self.position)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recorded) and other._index is self._index and other.position == self.position

    def __hash__(self) -> int:
        return hash((id(self._index), self.position))

    def __repr__(self) -> str:
        return f"Recorded({self.topic} {self.sequence} of {self.node}, boot {self.boot}, at {self.stamp_ns} ns)"


class Records(Sequence[Recorded]):
    """A sequence of recorded messages, which creates its elements on access."""

    def __init__(self, index: MessageIndex, positions: "Positions | range | tuple[()]") -> None:
        self._index = index
        self._positions = positions

    def __len__(self) -> int:
        return len(self._positions)

    @overload
    def __getitem__(self, number: int) -> Recorded: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[Recorded]: ...

    def __getitem__(self, number: int | slice) -> Recorded | Sequence[Recorded]:
        if isinstance(number, slice):
            return [self[item] for item in range(len(self))[number]]
        return Recorded(self._index, self._positions[number])


def _array(values: "np.ndarray[tuple[int], np.dtype[np.unsignedinteger]]") -> "array[int]":
    code = {2: "H", 4: "I", 8: "Q"}[values.itemsize]
    found = array(code)
    found.frombytes(values.tobytes())
    return found
