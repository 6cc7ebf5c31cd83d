"""ROS bags, 1 and 2, opened with the package rosbags; whatever it raises becomes an ImportFailedError."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from dynpf_formats.importers.bag_bounds import bound_chunks, check_mcap
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import Losses
from dynpf_formats.importers.text import refuse_pointer

__all__ = ["Bag", "Message", "open_bag"]

SUFFIXES = (".bag", ".mcap", ".db3")
MOST_DEFINITIONS = 64  # of the dozen types that are imported, which programs of other versions may define otherwise
IDL_SEPARATOR = "=" * 80 + "\n"  # between the files of a type's definition


class Message(NamedTuple):
    """A recorded message: its topic, time of arrival (ns) and content."""

    topic: str
    arrival_ns: int
    content: Any


class Bag:
    """An open bag: its topics with their types, and their messages in the order of arrival."""

    def __init__(self, path: Path, reader: Any, types: Collection[str]) -> None:
        self.path = path
        self._reader = reader
        # A topic that was announced and never used is none; a bag that was cut off may not know its counts.
        used = [connection for connection in reader.connections if connection.msgcount] or reader.connections
        self.topics: dict[str, str] = {connection.topic: connection.msgtype for connection in used}
        store = _typestore([connection for connection in reader.connections if connection.msgtype in types])
        self._decode = store.deserialize_ros1 if isinstance(reader, Reader1) else store.deserialize_cdr

    def of_type(self, *types: str) -> list[str]:
        """Return the topics of the given types, by name."""
        return sorted(name for name, kind in self.topics.items() if kind in types)

    def messages(self, topics: Collection[str], losses: Losses) -> Iterator[Message]:
        """Yield the messages of the given topics, without those that do not decode.

        A topic has one type; its messages of another are losses. Raises ImportFailedError if the rest of the bag cannot
        be read.
        """
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        last_ns = 0
        stream = iter(self._reader.messages(chosen)) if chosen else iter(())
        while True:
            try:
                connection, last_ns, data = next(stream)
            except StopIteration:
                return
            except Exception as error:  # the library lets through what its parts raise on broken bytes
                text = f"cannot be read beyond {last_ns * 1e-9:.3f} s"
                raise ImportFailedError(f"{self.path}: {text}: {_in_a_line(error)}") from error
            if connection.msgtype != self.topics[connection.topic]:
                expected = self.topics[connection.topic]
                losses.add("messages of another type", f"{connection.topic}: {connection.msgtype}, not {expected}")
                continue
            try:
                content = self._decode(data, connection.msgtype)
            except Exception as error:  # as above
                where = f"{connection.topic} at {last_ns * 1e-9:.3f} s: {_in_a_line(error)}"
                losses.add("messages that do not decode", where)
                continue
            yield Message(connection.topic, last_ns, content)


@contextmanager
def open_bag(path: Path, types: Collection[str]) -> Iterator[Bag]:
    """Open a .bag file, a .mcap or .db3 file, or the folder of a ROS 2 bag; raises ImportFailedError.

    ``types`` are the message types to be read; a bag may hold unreadable messages of other types.
    """
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        path = _only_part(path)
    if path.is_dir():
        for part in sorted(path.iterdir()):
            if part.suffix in SUFFIXES:
                _check_file(part)
    else:
        if path.suffix not in SUFFIXES:
            refuse_pointer(path)
            raise ImportFailedError(f"{path}: expected {', '.join(SUFFIXES)} or the folder of a ROS 2 bag")
        _check_file(path)
    with ExitStack() as stack:
        try:
            reader = stack.enter_context(Reader1(path) if path.suffix == ".bag" and path.is_file() else Reader2(path))
            if isinstance(reader, Reader1):
                bound_chunks(reader)
            bag = Bag(path, reader, types)
        except Exception as error:  # the library lets through what its parts raise on broken bytes
            raise ImportFailedError(f"{path}: cannot be read: {_in_a_line(error)}") from error
        yield bag


def _only_part(folder: Path) -> Path:
    """Return the one bag file in a folder whose metadata were never written; raises ImportFailedError."""
    parts = sorted(part for part in folder.iterdir() if part.suffix in SUFFIXES)
    if len(parts) == 1:
        return parts[0]
    names = ", ".join(part.name for part in parts[:5])
    hint = f"import one of its files: {names}" if parts else "expected the folder of a ROS 2 bag"
    raise ImportFailedError(f"{folder}: no metadata.yaml in it; {hint}")


def _check_file(path: Path) -> None:
    """Raise ImportFailedError for a file that is missing or empty, or that would unpack to more than a bag holds."""
    refuse_pointer(path)
    if path.suffix == ".mcap":
        check_mcap(path)


def _typestore(connections: Sequence[Any]) -> Any:
    """Return the types of the connections as the bag defines them, or Humble's for old ROS 2 bags, which do not."""
    store = get_typestore(Stores.EMPTY)
    found: dict[str, Any] = {}
    definitions = {(one.msgtype, one.msgdef.format, one.msgdef.data) for one in connections}
    if len(definitions) > MOST_DEFINITIONS:
        raise ValueError(f"it defines {len(definitions)} types of messages; at most {MOST_DEFINITIONS} are read")
    for name, form, text in sorted(definitions, key=lambda one: (one[0], one[1].value, one[2])):
        match form:
            case MessageDefinitionFormat.MSG:
                found.update(get_types_from_msg(text, name))
            case MessageDefinitionFormat.IDL:
                parts = [part.partition("\n")[2] for part in text.split(IDL_SEPARATOR)[1:]] or [text]
                for part in parts:
                    found.update(get_types_from_idl(part))
    for name, (_, fields) in found.items():
        _check_fields(name, dict(fields))
    store.register(found or get_typestore(Stores.ROS2_HUMBLE).fielddefs)
    return store


def _check_fields(name: str, fields: Mapping[str, Any]) -> None:
    """Raise ValueError if a standard type is defined without one of its fields, or with one of another kind.

    The fields of the types that are imported are the same in all versions of ROS, but that ROS 1 has more.
    """
    for field, kind in get_typestore(Stores.ROS2_HUMBLE).fielddefs.get(name, ((), ()))[1]:
        if fields.get(field) != kind:
            raise ValueError(f"it defines {name} otherwise than ROS, without its field {field}")


def _in_a_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{text or 'no reason given'} ({type(error).__name__})"[:200]
