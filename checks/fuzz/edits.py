"""Structure-aware edits of a recording, after which ``Anatomy.bytes`` makes every checksum right again."""

import json
from collections.abc import Callable
from random import Random
from typing import Any

from dynpf_formats.recording.header import RUN, RUN_END, checksum
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from checks.fuzz.anatomy import Anatomy, Cluster, Item
from checks.fuzz.values import Values, as_json, torn

__all__ = ["EDITS", "edited"]

Edit = Callable[[Anatomy, Values], None]
_WORDS = (0, 1, 2, 255, 2**16 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
_NAMES = ("", "x", "../up", "/etc/passwd", "\x1b[2J", "n" * 300, "files/", "files/a/../b", "simulator", "estimator")


def edited(anatomy: Anatomy, random: Random) -> bytes:
    """Return a changed file: one or a few edits of its structure, and sometimes damage of its bytes."""
    changed, values = anatomy.copy(), Values(random)
    for _ in range(random.choice((1, 1, 1, 2, 2, 3, 6))):
        random.choice(EDITS)(changed, values)
    data = changed.bytes()
    return torn(data, random) if random.random() < 0.1 else data


def _payload(anatomy: Anatomy, values: Values) -> None:
    if messages := anatomy.of_type(Message):
        message = values.random.choice(messages)
        message.data = _changed(message.data, values)


def _payloads_of_topic(anatomy: Anatomy, values: Values) -> None:
    if channels := anatomy.of_type(Channel):
        chosen = values.random.choice(channels).id
        for message in anatomy.of_type(Message):
            if message.channel_id == chosen:
                message.data = _changed(message.data, values)


def _changed(data: bytes, values: Values) -> bytes:
    """Return a payload with a part changed; or torn, empty, or something else altogether."""
    match values.random.random():
        case share if share < 0.85:
            try:
                return as_json(values.changed(json.loads(data))).encode(errors="surrogatepass")
            except (ValueError, RecursionError):
                return torn(data, values.random)
        case share if share < 0.9:
            return as_json(values.value()).encode(errors="surrogatepass")
        case share if share < 0.95:
            return values.random.choice((b"", b"\xff\xfe", b"{", b"[" * 100_000, b'"\\ud800"', b"1e400", b"nul"))
    return torn(data, values.random)


def _envelope(anatomy: Anatomy, values: Values) -> None:
    if messages := anatomy.of_type(Message):
        for message in values.random.sample(messages, min(len(messages), values.random.choice((1, 1, 3, 50)))):
            match values.random.choice(("sequence", "sequence", "log_time", "publish_time", "channel_id")):
                case "sequence":
                    message.sequence = (message.sequence + values.random.choice((1, -1, 2, 10**6))) % 2**32
                case "channel_id":
                    message.channel_id = values.random.choice(
                        (*(channel.id for channel in anatomy.of_type(Channel)), 0, 2**16 - 1)
                    )
                case name:
                    setattr(message, name, values.random.choice(_WORDS))


def _channel(anatomy: Anatomy, values: Values) -> None:
    if channels := anatomy.of_type(Channel):
        channel, random = values.random.choice(channels), values.random
        match random.choice(("topic", "topic", "node", "boot", "bare", "id", "schema")):
            case "topic":
                channel.topic = random.choice((random.choice(channels).topic, values.text(), "journal/x", "event/y"))
            case "bare":
                channel.metadata = {}
            case "id":
                channel.id = random.choice((0, 2**16 - 1, random.choice(channels).id))
            case "schema":
                channel.schema_id = random.choice((0, 2**16 - 1, random.choice(channels).schema_id))
            case name:
                channel.metadata[name] = random.choice((*_NAMES, random.choice(channels).metadata.get(name, "")))


def _schema(anatomy: Anatomy, values: Values) -> None:
    if schemas := anatomy.of_type(Schema):
        schema = values.random.choice(schemas)
        match values.random.choice(("name", "data", "data", "id")):
            case "name":
                schema.name = values.random.choice((values.random.choice(schemas).name, values.text()))
            case "data":
                schema.data = _changed(schema.data, values)
            case "id":
                schema.id = values.random.choice((0, 1, 2, 2**16 - 1))


def _order(anatomy: Anatomy, values: Values) -> None:
    """Drop, repeat, exchange or move records of one chunk."""
    if clusters := [cluster for cluster in anatomy.clusters() if cluster.records]:
        records, random = values.random.choice(clusters).records, values.random
        first, second = random.randrange(len(records)), random.randrange(len(records))
        match random.choice(("drop", "repeat", "exchange", "cut", "flood")):
            case "drop":
                del records[first]
            case "repeat":
                records.insert(second, records[first])
            case "exchange":
                records[first], records[second] = records[second], records[first]
            case "cut":
                del records[first:]
            case "flood":
                records[second:second] = [records[first]] * random.choices((100, 5000), (95, 5))[0]


def _items(anatomy: Anatomy, values: Values) -> None:
    """Drop, repeat, exchange chunks, metadata and attachments; or take messages out of their chunk."""
    items, random = anatomy.items, values.random
    if not items:
        return
    first, second = random.randrange(len(items)), random.randrange(len(items))
    match random.choice(("drop", "repeat", "exchange", "cut", "unpack", "empty")):
        case "drop":
            del items[first]
        case "repeat":
            items[second:second] = [items[first]] * random.choice((1, 1, 30))
        case "exchange":
            items[first], items[second] = items[second], items[first]
        case "cut":
            del items[first + 1 :]
        case "unpack":
            items[:] = [part for item in items for part in _unpacked(item)]
        case "empty":
            items.insert(first, Cluster([]))


def _unpacked(item: Item) -> list[Any]:
    return item.records if isinstance(item, Cluster) else [item]


def _run(anatomy: Anatomy, values: Values) -> None:
    """Change the metadata of the run; mostly its scenario."""
    if (run := anatomy.metadata(RUN)) is None:
        return
    if values.random.random() < 0.8 and "scenario" in run.metadata:
        try:
            scenario = json.loads(run.metadata["scenario"])
        except (ValueError, RecursionError):
            return
        run.metadata["scenario"] = as_json(values.changed(scenario))
    else:
        _entry(run, values)
    _checked(run)


def _run_end(anatomy: Anatomy, values: Values) -> None:
    if (end := anatomy.metadata(RUN_END)) is not None:
        _entry(end, values)
        _checked(end)


def _entry(metadata: Metadata, values: Values) -> None:
    """Change one entry, as JSON where it is that."""
    if not metadata.metadata:
        return
    name = values.random.choice(list(metadata.metadata))
    text = metadata.metadata[name]
    match values.random.choice(("json", "json", "text", "drop", "name")):
        case "drop":
            del metadata.metadata[name]
        case "name":
            metadata.name = values.random.choice((RUN, RUN_END, values.text()))
        case "text":
            metadata.metadata[name] = values.text()
        case _:
            metadata.metadata[name] = _changed(text.encode(errors="replace"), values).decode(errors="replace")


def _checked(metadata: Metadata) -> None:
    if "sha256" in metadata.metadata:
        entries = {key: value for key, value in metadata.metadata.items() if key != "sha256"}
        try:
            metadata.metadata["sha256"] = checksum(entries)
        except UnicodeError:
            metadata.metadata.clear()


def _attachment(anatomy: Anatomy, values: Values) -> None:
    attachments, random = anatomy.of_type(Attachment), values.random
    if not attachments or random.random() < 0.2:
        data = random.choice((b"", b"{}", as_json(values.value()).encode(errors="surrogatepass")))
        name = random.choice((*_NAMES, "landmarks.json", "files/map.yaml", "files/map.pgm"))
        anatomy.items.insert(1, Attachment(0, 0, name, "", data))
        return
    attachment = random.choice(attachments)
    match random.choice(("data", "data", "name", "large")):
        case "data":
            attachment.data = _map_changed(attachment.data, values)
        case "name":
            attachment.name = random.choice((*_NAMES, random.choice(attachments).name))
        case "large":
            attachment.data = bytes(random.choice((10**5, 10**6)))


def _map_changed(data: bytes, values: Values) -> bytes:
    """Change a word of a map's text or of an image's header, or a JSON document, or tear the bytes."""
    random = values.random
    if data[:1] in b"[{" and random.random() < 0.8:
        return _changed(data, values)
    head, rest = data[:200], data[200:]
    if words := head.split():
        word = random.choice(words)
        number = str(random.choice((values.number(), random.randrange(40_000)))).encode()
        return head.replace(word, number, 1) + rest if random.random() < 0.7 else torn(data, random)
    return data


def _layout(anatomy: Anatomy, values: Values) -> None:
    """Lay the file out as other writers do, or as no writer does."""
    match values.random.choice(("crc", "summary", "plain", "profile", "tail", "lz4")):
        case "crc":
            anatomy.data_crc = False
            anatomy.chunk_crc = values.random.random() < 0.5
        case "summary":
            anatomy.summary = False
        case "plain":
            for cluster in anatomy.clusters():
                cluster.compression = ""
        case "profile":
            anatomy.header.profile = values.text()
        case "tail":
            for cluster in anatomy.clusters()[:1]:
                cluster.tail = values.random.randbytes(30)
        case "lz4":
            for cluster in anatomy.clusters()[:1]:
                cluster.compression = "lz4"


def _bomb(anatomy: Anatomy, values: Values) -> None:
    """Put in a few kilobytes that become much more: empty records, repeated ones, zeros, or ever new channels."""
    random = values.random
    if random.random() < 0.95:
        return  # they take their time
    schema = b"\x03" + (16).to_bytes(8, "little") + (1).to_bytes(2, "little") + b"\0" * 14
    message = b"\x05" + (22).to_bytes(8, "little") + b"\0" * 22
    zeros = b"\x05" + (2**20).to_bytes(8, "little") + b"\0" * 2**20
    tail = random.choice((schema * 10**5, message * 10**5, schema * 10**6, zeros * 60, zeros * 20))
    cluster = Cluster([], tail=tail)
    for _ in range(random.choice((1, 1, 5))):
        anatomy.items.insert(random.randrange(len(anatomy.items) + 1), cluster)


def _many_channels(anatomy: Anatomy, values: Values) -> None:
    random = values.random
    number_of_channels = random.choices((10, 1000, 5000), (90, 8, 2))[0]
    conflicting = random.random() < 0.5
    records: list[Any] = [
        Channel(
            id=1 if conflicting else number + 100,
            topic=random.choice(("log/truth", "t")) if conflicting else f"t{number}",
            message_encoding="json",
            metadata={"node": f"n{number}" if conflicting else "n", "boot": "b"},
            schema_id=1,
        )
        for number in range(number_of_channels)
    ]
    anatomy.items.insert(random.randrange(len(anatomy.items) + 1), Cluster(records))


EDITS: tuple[Edit, ...] = (
    *(_payload, _payload, _payloads_of_topic, _envelope, _envelope, _channel, _schema, _order, _order, _items),
    *(_run, _run, _run_end, _attachment, _attachment, _layout, _bomb, _many_channels),
)
