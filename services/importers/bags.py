"""ROS bags, 1 and 2, opened with the package rosbags; whatever that raises is told as an import's failure."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from services.importers.errors import ImportFailedError
from services.importers.stream import Losses
from services.importers.text import refuse_pointer

__all__ = ["Bag", "Message", "open_bag"]

SUFFIXES = (".bag", ".mcap", ".db3")


class Message(NamedTuple):
    """A message as it was recorded: its topic, when it arrived (ns), and what it says."""

    topic: str
    arrival_ns: int
    content: Any


class Bag:
    """An open bag: its topics with their types, and their messages in the order of arrival."""

    def __init__(self, path: Path, reader: Any) -> None:
        self.path = path
        self._reader = reader
        self.topics: dict[str, str] = {one.topic: one.msgtype for one in reader.connections}

    def of_type(self, *types: str) -> list[str]:
        """Return the topics of the given types, by name."""
        return sorted(name for name, kind in self.topics.items() if kind in types)

    def count(self, topic: str) -> int:
        return sum(one.msgcount for one in self._reader.connections if one.topic == topic)

    def messages(self, topics: Collection[str], losses: Losses) -> Iterator[Message]:
        """Yield the messages of the given topics; those that do not decode are left out.

        Raises ImportFailedError where the bag cannot be read on.
        """
        chosen = [one for one in self._reader.connections if one.topic in topics]
        last_ns = 0
        stream = iter(self._reader.messages(chosen)) if chosen else iter(())
        while True:
            try:
                connection, last_ns, data = next(stream)
            except StopIteration:
                return
            except Exception as error:  # the library lets through what its parts raise on broken bytes
                told = f"cannot be read beyond {last_ns * 1e-9:.3f} s"
                raise ImportFailedError(f"{self.path}: {told}: {_in_a_line(error)}") from error
            try:
                content = self._reader.deserialize(data, connection.msgtype)
            except Exception as error:  # as above
                place = f"{connection.topic} at {last_ns * 1e-9:.3f} s: {_in_a_line(error)}"
                losses.add("messages that do not decode", place)
                continue
            yield Message(connection.topic, last_ns, content)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a .bag file, a .mcap or .db3 file, or the folder of a ROS 2 bag; raises ImportFailedError."""
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise ImportFailedError(f"{path}: no metadata.yaml in it; expected the folder of a ROS 2 bag")
        for part in sorted(path.iterdir()):
            if part.suffix in SUFFIXES:
                refuse_pointer(part)
    else:
        refuse_pointer(path)
        if path.suffix not in SUFFIXES:
            raise ImportFailedError(f"{path}: expected {', '.join(SUFFIXES)} or the folder of a ROS 2 bag")
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # the library lets through what its parts raise on broken bytes
        raise ImportFailedError(f"{path}: cannot be read: {_in_a_line(error)}") from error
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _in_a_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{text or 'no reason given'} ({type(error).__name__})"[:200]
