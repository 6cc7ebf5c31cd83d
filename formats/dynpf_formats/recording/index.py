"""The places of a recording's messages, in arrays of some tens of bytes a message; payloads are fetched on demand."""

from array import array
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from dynpf_formats.recording.errors import CorruptRecordingError
from dynpf_formats.recording.mcap_records import Region, unpack
from dynpf_formats.recording.stream import Source, StreamedMessage

__all__ = ["MessageIndex", "Places", "Recorded", "Records"]

_CACHE_BYTES = 16 * 2**20


class _Payloads:
    """Payloads by chunk: the chunks used last are kept, uncompressed, up to _CACHE_BYTES."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offsets = array("Q")
        self._lengths = array("Q")
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._cached = 0

    def add(self, region: Region) -> int:
        """Take up a chunk that has just been read; return its number."""
        self._offsets.append(region.offset)
        self._lengths.append(region.length)
        self._keep(len(self._offsets) - 1, region.data)
        return len(self._offsets) - 1

    def get(self, chunk: int, start: int, stop: int) -> bytes:
        data = self._cache.get(chunk)
        if data is None:
            data = self._fetch(chunk)
            self._keep(chunk, data)
        else:
            self._cache.move_to_end(chunk)
        return data[start:stop]

    def _keep(self, chunk: int, data: bytes) -> None:
        self._cache[chunk] = data
        self._cached += len(data)
        while self._cached > _CACHE_BYTES and len(self._cache) > 1:
            self._cached -= len(self._cache.popitem(last=False)[1])

    def _fetch(self, chunk: int) -> bytes:
        try:
            with self._path.open("rb") as stream:
                stream.seek(self._offsets[chunk])
                return unpack(stream.read(self._lengths[chunk]))
        except (OSError, ValueError) as error:
            raise CorruptRecordingError(f"{self._path}: changed while it was in use: {error}") from error


class Places:
    """Where the messages of one source are: their places in the file's order, by sequence, each number once."""

    def __init__(self, places: "array[int]", sequences: "array[int]", begin: int, end: int) -> None:
        self._places = places
        self._sequences = sequences
        self._begin = begin
        self._end = end

    def __len__(self) -> int:
        return self._end - self._begin

    def __getitem__(self, number: int) -> int:
        return self._places[range(self._begin, self._end)[number]]

    def find(self, sequence: int) -> int | None:
        """Return the place of a sequence number, or None."""
        if sequence < len(self) and self._sequences[self[sequence]] == sequence:  # none before it is missing
            return self[sequence]
        number = bisect_left(range(len(self)), sequence, key=lambda number: self._sequences[self[number]])
        found = number < len(self) and self._sequences[self[number]] == sequence
        return self[number] if found else None


class MessageIndex:
    """Everything recorded, journal and repetitions too, in the order of the file.

    It is filled by ``chunk`` and ``add``, and used after ``close``.
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
        self._by_source: dict[Source, Places] = {}
        self._is_first = b""
        self._chunk = 0

    def __len__(self) -> int:
        return len(self.sequences)

    def chunk(self, region: Region) -> None:
        """Take up the chunk that the messages to come are in."""
        self._chunk = self._payloads.add(region)

    def add(self, message: StreamedMessage) -> None:
        self._channels.append(message.channel)
        self.sequences.append(message.sequence)
        self.stamps_ns.append(message.stamp_ns)
        self.publish_ns.append(message.publish_ns)
        self._chunks.append(self._chunk)
        self._starts.append(message.start)
        self._stops.append(message.stop)

    def close(self, described: Mapping[int, Source]) -> None:
        """Name the channels, leave out the messages of those without a name, and sort by source and sequence."""
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
        order = np.lexsort((sequences, number)).astype(np.uint32)  # stable: of a repetition the first comes first
        by_number, by_sequence = number[order], sequences[order]
        is_new = np.ones(len(order), bool)
        is_new[1:] = (by_number[1:] != by_number[:-1]) | (by_sequence[1:] != by_sequence[:-1])
        order, by_number = order[is_new], by_number[is_new]
        is_first = np.zeros(len(number), bool)
        is_first[order] = True
        self._is_first = is_first.tobytes()
        bounds = np.searchsorted(by_number, np.arange(len(self.sources) + 1)).tolist()
        places = _array(order)
        self._by_source = {
            source: Places(places, self.sequences, bounds[place], bounds[place + 1])
            for place, source in enumerate(self.sources)
        }

    def source(self, place: int) -> Source:
        return self.sources[self._numbers[place]]

    def size(self, place: int) -> int:
        return self._stops[place] - self._starts[place]

    def payload(self, place: int) -> bytes:
        return self._payloads.get(self._chunks[place], self._starts[place], self._stops[place])

    def find(self, source: Source, sequence: int) -> int | None:
        """Return the place of the first message with this number, or None if it was not recorded."""
        places = self._by_source.get(source)
        return None if places is None else places.find(sequence)

    def is_first(self, place: int) -> bool:
        """Return whether no message before has the same source and number."""
        return bool(self._is_first[place])

    def of(self, source: Source) -> "Records":
        return Records(self, self._by_source.get(source, ()))

    def all(self) -> "Records":
        return Records(self, range(len(self)))

    def firsts(self, wanted: Sequence[bool]) -> Iterator[int]:
        """Yield the places of messages that repeat none, of the sources (by number) that are wanted."""
        for place, (number, first) in enumerate(zip(self._numbers, self._is_first, strict=True)):
            if first and wanted[number]:
                yield place


class Recorded:
    """One recorded message; ``payload`` comes from the file when it is asked for."""

    __slots__ = ("_index", "place")

    def __init__(self, index: MessageIndex, place: int) -> None:
        self._index = index
        self.place = place

    @property
    def source(self) -> Source:
        return self._index.source(self.place)

    @property
    def topic(self) -> str:
        return self.source.topic

    @property
    def node(self) -> str:
        return self.source.node

    @property
    def boot(self) -> str:
        return self.source.boot

    @property
    def sequence(self) -> int:
        return self._index.sequences[self.place]

    @property
    def stamp_ns(self) -> int:
        return self._index.stamps_ns[self.place]

    @property
    def publish_ns(self) -> int:
        return self._index.publish_ns[self.place]

    @property
    def size(self) -> int:
        """Length of the payload in bytes."""
        return self._index.size(self.place)

    @property
    def payload(self) -> bytes:
        return self._index.payload(self.place)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recorded) and other._index is self._index and other.place == self.place

    def __hash__(self) -> int:
        return hash((id(self._index), self.place))

    def __repr__(self) -> str:
        return f"Recorded({self.topic} {self.sequence} of {self.node}, boot {self.boot}, at {self.stamp_ns} ns)"


class Records(Sequence[Recorded]):
    """Recorded messages by their places; each is made when it is asked for."""

    def __init__(self, index: MessageIndex, places: "Places | range | tuple[()]") -> None:
        self._index = index
        self._places = places

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, number: int) -> Recorded: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[Recorded]: ...

    def __getitem__(self, number: int | slice) -> Recorded | Sequence[Recorded]:
        if isinstance(number, slice):
            return [self[item] for item in range(len(self))[number]]
        return Recorded(self._index, self._places[number])


def _array(values: "np.ndarray[tuple[int], np.dtype[np.unsignedinteger]]") -> "array[int]":
    code = {2: "H", 4: "I", 8: "Q"}[values.itemsize]
    found = array(code)
    found.frombytes(values.tobytes())
    return found
