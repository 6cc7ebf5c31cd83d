"""The kinds of edits: what somebody could change in a recording that is taken apart."""

import json
from collections.abc import Callable
from random import Random
from typing import Any, NamedTuple

from dynpf_formats.recording.attachments import FOLDER, LANDMARKS, is_file
from dynpf_formats.recording.header import RUN, RUN_END, Attachment, NodeEnd, SealedChannel, as_entries
from dynpf_formats.recording.stream import RecordedSchema
from dynpf_protocol.control import Outcome
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, encode_entry
from dynpf_protocol.topics import LOG_NODE, is_compared
from msgspec.structs import replace

from checks.edits.content import Content, Row, entry_of, replaced

__all__ = ["KINDS", "Kind"]

Change = Callable[[Content, Random], Content | None]


class Kind(NamedTuple):
    """A kind of edit.

    ``change`` returns the changed content, or None where there is nothing to change. ``what`` is what it changes:
    "compared", "journal", "metadata", "attachments", or "not compared". ``input`` says that a run with other inputs
    looks the same, ``free`` that nothing but the seal and a signature covers what it changes. An ``end`` is changed
    after chain and seal are made right.
    """

    name: str
    what: str
    change: Change
    input: bool = False
    free: bool = False
    end: bool = False


def _messages(content: Content, *, compared: bool = True, log: bool = False) -> list[int]:
    return [
        index
        for index, row in enumerate(content.rows)
        if not row.topic.startswith(JOURNAL_PREFIX)
        and is_compared(row.topic) == compared
        and (row.node == LOG_NODE) == log
    ]


def _on_message(change: Callable[[Row, Random], tuple[Row, ...]], **which: bool) -> Change:
    def apply(content: Content, random: Random) -> Content | None:
        indices = _messages(content, **which)
        if not indices:
            return None
        index = random.choice(indices)
        return content._replace(rows=replaced(content.rows, index, *change(content.rows[index], random)))

    return apply


def _on_entry(change: Callable[[JournalEntry, Random], JournalEntry | None]) -> Change:
    def apply(content: Content, random: Random) -> Content | None:
        index = random.choice([index for index, row in enumerate(content.rows) if entry_of(row) is not None])
        row = content.rows[index]
        entry = entry_of(row)
        changed = change(entry, random) if entry is not None else None
        if changed is None or changed == entry:
            return None
        return content._replace(rows=replaced(content.rows, index, row._replace(payload=encode_entry(changed))))

    return apply


def _exchanged_entries(content: Content, random: Random) -> Content | None:
    """Exchange two entries, of one node or of two."""
    indices = [index for index, row in enumerate(content.rows) if entry_of(row) is not None]
    first, second = random.sample(indices, 2)
    rows = list(content.rows)
    one, other = rows[first], rows[second]
    rows[first], rows[second] = one._replace(payload=other.payload), other._replace(payload=one.payload)
    return content._replace(rows=tuple(rows))


def _number(payload: bytes, random: Random) -> bytes:
    """Return a JSON payload with one of its numbers changed a little."""
    value = json.loads(payload)
    places: list[tuple[Any, Any]] = []

    def walk(inner: Any) -> None:
        for key, child in inner.items() if isinstance(inner, dict) else enumerate(inner):
            if isinstance(child, dict | list):
                walk(child)
            elif isinstance(child, float):
                places.append((inner, key))

    walk(value)
    if not places:
        return payload + b" "
    inner, key = random.choice(places)
    inner[key] += random.choice((1e-9, 1e-3, 0.1))
    return json.dumps(value, separators=(",", ":")).encode()


def _altered(row: Row, random: Random) -> tuple[Row, ...]:
    return (row._replace(payload=_number(row.payload, random)),)


def _swapped_payloads(content: Content, random: Random) -> Content | None:
    first = random.choice(_messages(content))
    same = [
        index
        for index in _messages(content)
        if content.rows[index].source == content.rows[first].source
        and content.rows[index].payload != content.rows[first].payload
    ]
    if not same:
        return None
    second = random.choice(same)
    rows = list(content.rows)
    one, other = rows[first], rows[second]
    rows[first], rows[second] = one._replace(payload=other.payload), other._replace(payload=one.payload)
    return content._replace(rows=tuple(rows))


def _orphan(row: Row, random: Random) -> tuple[Row, ...]:
    boot = random.choice((row.boot, "zzz"))
    sequence = 10_000 if boot == row.boot else 0
    return row, row._replace(boot=boot, sequence=sequence)


def _renamed_boot(content: Content, random: Random) -> Content:
    node = random.choice([row.node for row in content.rows if entry_of(row) is not None])

    def rename(row: Row) -> Row:
        entry = entry_of(row)
        if entry is not None:
            consumed = tuple(replace(one, boot="other") if one.node == node else one for one in entry.consumed)
            row = row._replace(payload=encode_entry(replace(entry, consumed=consumed)))
        return row._replace(boot="other") if row.node == node else row

    return content._replace(rows=tuple(rename(row) for row in content.rows))


def _cut(content: Content, random: Random) -> Content:
    """Drop all ticks from one on: the messages that they made, and their entries."""
    ticks = max(end.tick for end in content.end.nodes.values())
    first = random.randint(1, ticks)
    entries = [(row, entry) for row in content.rows if (entry := entry_of(row)) is not None and entry.tick >= first]
    gone = {(row.source, row.sequence) for row, _ in entries}
    for row, entry in entries:
        gone |= {(row.source._replace(topic=one.topic), one.sequence) for one in entry.produced}
        gone |= {(row.source._replace(topic=one.topic, node=one.node), one.sequence) for one in entry.hosted}
    return content._replace(rows=tuple(row for row in content.rows if (row.source, row.sequence) not in gone))


def _cut_and_ended(content: Content, random: Random) -> Content:
    """Cut, and call the last entries that are left the last."""
    cut = _cut(content, random)
    last = max(entry.tick for row in cut.rows if (entry := entry_of(row)) is not None)

    def end(row: Row) -> Row:
        entry = entry_of(row)
        if entry is None or entry.tick != last:
            return row
        return row._replace(payload=encode_entry(replace(entry, last=True)))

    return cut._replace(rows=tuple(end(row) for row in cut.rows))


def _dropped_entry(content: Content, random: Random, *, last: bool = False) -> Content:
    found = [(index, entry) for index, row in enumerate(content.rows) if (entry := entry_of(row)) is not None]
    index = random.choice([index for index, entry in found if entry.last or not last])
    return content._replace(rows=replaced(content.rows, index))


def _repeated_entry(content: Content, random: Random) -> Content:
    index = random.choice([index for index, row in enumerate(content.rows) if entry_of(row) is not None])
    return content._replace(rows=replaced(content.rows, index, content.rows[index], content.rows[index]))


def _references(entry: JournalEntry, random: Random) -> JournalEntry | None:
    """Drop, exchange, repeat or change a reference."""
    name = random.choice([name for name in ("consumed", "produced", "hosted") if getattr(entry, name)] or [""])
    if not name:
        return None
    found = list(getattr(entry, name))
    index = random.randrange(len(found))
    match random.randrange(4):
        case 0:
            del found[index]
        case 1:
            found.reverse()
        case 2:
            found.insert(index, found[index])
        case _:
            found[index] = replace(found[index], sequence=found[index].sequence + random.choice((1, 1000)))
    return replace(entry, **{name: tuple(found)})


def _scenario(content: Content, random: Random) -> Content:
    scenario = json.loads(content.header.scenario)
    key = random.choice([key for key, value in scenario.items() if isinstance(value, str | int | float)])
    scenario[key] = f"{scenario[key]}x" if isinstance(scenario[key], str) else scenario[key] + 1
    text = json.dumps(scenario, separators=(",", ":"), ensure_ascii=False)
    return content._replace(header=replace(content.header, scenario=text))


def _header(content: Content, random: Random) -> Content:
    header = content.header
    fewer = {node: topics for node, topics in header.writes.items() if node != random.choice([*header.writes])}
    changed = random.choice(
        (
            replace(header, seed=header.seed + 1),
            replace(header, writes=fewer if fewer != header.writes else {}),
            replace(header, writes={}),
            replace(header, clock="realtime" if header.clock == "lockstep" else "lockstep"),
        )
    )
    return content._replace(header=changed)


def _provenance(content: Content, _random: Random) -> Content:
    made = replace(content.header.provenance, code_digest="0" * 64)
    return content._replace(header=replace(content.header, provenance=made))


def _end(content: Content, random: Random) -> Content:
    end = content.end
    topic, node = random.choice(sorted(end.counts)), random.choice(sorted(end.nodes))
    steps, tick, last, chain = end.nodes[node]
    changed = random.choice(
        (
            replace(end, counts={**end.counts, topic: end.counts[topic] + random.choice((-1, 1))}),
            replace(end, missing=end.missing + 1),
            replace(end, duplicates=end.duplicates + 1),
            replace(end, unresolved=1),
            replace(end, complete=False),
            replace(end, header="0" * 64),
            replace(end, channels=_channels(end.channels, random, compared=True)),
            replace(end, nodes={**end.nodes, node: NodeEnd(steps + 1, tick, last, chain)}),
            replace(end, nodes={**end.nodes, node: NodeEnd(steps, tick, last, "0" * 64)}),
        )
    )
    return content._replace(end=changed)


def _channels(channels: tuple[SealedChannel, ...], random: Random, *, compared: bool) -> tuple[SealedChannel, ...]:
    """Drop or alter the digest of a source that is compared, or of one that is not."""
    index = random.choice([index for index, channel in enumerate(channels) if is_compared(channel.topic) == compared])
    new = random.choice(((), (channels[index]._replace(digest="0" * 64),)))
    return (*channels[:index], *new, *channels[index + 1 :])


def _end_not_compared(content: Content, random: Random) -> Content | None:
    channels = _channels(content.end.channels, random, compared=False)
    return content._replace(end=replace(content.end, channels=channels))


def _reason(content: Content, _random: Random) -> Content:
    return content._replace(end=replace(content.end, reason="stopped by the user"))


def _outcome(content: Content, random: Random) -> Content:
    return content._replace(end=replace(content.end, outcome=random.choice((*Outcome, "", "won"))))


def _metadata(content: Content, random: Random) -> Content:
    """Add a metadata record: a foreign one, or a second one of the run, as it is or altered."""
    seeded = replace(content.header, seed=content.header.seed + 1)
    name, entries = random.choice(
        (
            ("foreign", {"truth": "0"}),
            (RUN, as_entries(content.header)),
            (RUN, as_entries(seeded)),
            (RUN_END, as_entries(content.end)),
        )
    )
    return content._replace(foreign=((name, entries),))


def _schema(content: Content, random: Random) -> Content:
    topic = random.choice(sorted({row.topic for row in content.rows} & {*content.schemas}))
    schema = content.schemas[topic]
    return content._replace(schemas={**content.schemas, topic: RecordedSchema(schema.name, schema.data + b" ")})


def _file(content: Content, random: Random) -> Content | None:
    return _attachment(content, random, of_scenario=True)


def _log_landmarks(content: Content, random: Random) -> Content | None:
    return _attachment(content, random, of_scenario=False)


def _attachment(content: Content, random: Random, *, of_scenario: bool) -> Content | None:
    """Remove, alter, rename or repeat a file that the scenario names, or one of a log that is played."""
    indices = [index for index, item in enumerate(content.attachments) if is_file(item) == of_scenario]
    if not indices:
        return None
    index = random.choice(indices)
    item = content.attachments[index]
    place = random.randrange(len(item.data))
    flipped = item.data[:place] + bytes([item.data[place] ^ 1]) + item.data[place + 1 :]
    new = random.choice(((), (replace(item, data=flipped),), (replace(item, name=f"{item.name}x"),), (item, item)))
    return content._replace(attachments=(*content.attachments[:index], *new, *content.attachments[index + 1 :]))


def _added_attachment(content: Content, random: Random) -> Content | None:
    name = random.choice(("extra.txt", f"{FOLDER}extra.txt", LANDMARKS))
    if name in {item.name for item in content.attachments}:
        return None
    extra = Attachment(name=name, media_type="application/json", data=b"[]")
    return content._replace(attachments=(*content.attachments, extra))


def _order(content: Content, random: Random) -> Content | None:
    """Exchange two neighbours of different sources, behind the first rows of all sources."""
    begun = max({row.source: index for index, row in reversed([*enumerate(content.rows)])}.values())
    places = [
        index
        for index in range(begun + 1, len(content.rows) - 1)
        if content.rows[index].source != content.rows[index + 1].source
    ]
    if not places:
        return None
    index = random.choice(places)
    rows = list(content.rows)
    rows[index : index + 2] = rows[index + 1], rows[index]
    return content._replace(rows=tuple(rows))


KINDS = (
    Kind("message dropped", "compared", _on_message(lambda _row, _random: ())),
    Kind("message repeated", "compared", _on_message(lambda row, _random: (row, row))),
    Kind("message repeated with another payload", "compared", _on_message(lambda row, _: (row, *_altered(row, _)))),
    Kind("payload altered", "compared", _on_message(_altered)),
    Kind("payloads exchanged", "compared", _swapped_payloads),
    Kind("stamp altered", "compared", _on_message(lambda row, _: (row._replace(stamp_ns=row.stamp_ns + 1),))),
    Kind("sequence altered", "compared", _on_message(lambda row, _: (row._replace(sequence=row.sequence + 1),))),
    Kind("boot altered", "compared", _on_message(lambda row, _: (row._replace(boot="zzz"),))),
    Kind("sender altered", "compared", _on_message(lambda row, _: (row._replace(node="vision"),))),
    Kind("topic altered", "compared", _on_message(lambda row, _: (row._replace(topic="sensors/position"),))),
    Kind("message that no step produced", "compared", _on_message(_orphan)),
    Kind("record of the log altered", "compared", _on_message(_altered, log=True), input=True),
    Kind("record of the log dropped", "compared", _on_message(lambda _row, _random: (), log=True)),
    Kind("ticks cut off", "journal", _cut),
    Kind("ticks cut off, others called the last", "journal", _cut_and_ended, input=True),
    Kind("entry dropped", "journal", _dropped_entry),
    Kind("last entry dropped", "journal", lambda content, random: _dropped_entry(content, random, last=True)),
    Kind("entry repeated", "journal", _repeated_entry),
    Kind("entries exchanged", "journal", _exchanged_entries),
    Kind("references altered", "journal", _on_entry(_references)),
    Kind("tick altered", "journal", _on_entry(lambda entry, _: replace(entry, tick=entry.tick + 1))),
    Kind("step altered", "journal", _on_entry(lambda entry, _: replace(entry, step=entry.step + 1))),
    Kind("time of a step altered", "journal", _on_entry(lambda entry, _: replace(entry, stamp_ns=entry.stamp_ns + 1))),
    Kind("state altered", "journal", _on_entry(lambda entry, _: replace(entry, state="0" * 64))),
    Kind("state removed", "journal", _on_entry(lambda entry, _: replace(entry, state="", chain=""))),
    Kind("last step altered", "journal", _on_entry(lambda entry, _: replace(entry, last=not entry.last))),
    Kind("scenario altered", "metadata", _scenario, input=True),
    Kind("seed, nodes or clock altered", "metadata", _header),
    Kind("provenance altered", "metadata", _provenance, free=True),
    Kind("end of the run altered", "metadata", _end, end=True),
    Kind("end of the run altered, for diagnostics", "not compared", _end_not_compared, end=True),
    Kind("reason of the end altered", "not compared", _reason, end=True, free=True),
    Kind("outcome altered", "metadata", _outcome, end=True, input=True),
    Kind("metadata record added", "metadata", _metadata),
    Kind("schema altered", "not compared", _schema, free=True),
    Kind("file of the scenario altered", "attachments", _file),
    Kind("landmarks of the log altered", "attachments", _log_landmarks, input=True),
    Kind("attachment added", "attachments", _added_attachment),
    Kind(
        "publish time altered",
        "not compared",
        _on_message(lambda row, _: (row._replace(publish_ns=row.publish_ns + 1),)),
        free=True,
    ),
    Kind("order in the file altered", "not compared", _order, free=True),
    Kind("boot of a process renamed", "not compared", _renamed_boot, free=True),
    Kind("diagnostics altered", "not compared", _on_message(_altered, compared=False), free=True),
)
