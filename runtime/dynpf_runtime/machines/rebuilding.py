"""Rebuilding: a recorder's new start takes its ledger from the recording of the one before, and writes that anew.

What was written of steps that are not whole is left out: their nodes say it again.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import ProtocolError, RunError
from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry
from dynpf_protocol.keys import RECORDER, ROUTER
from dynpf_protocol.messages import Restart
from dynpf_protocol.topics import LOG_NODE, Topic

from dynpf_runtime.machines.effects import Effect, Mend, Record
from dynpf_runtime.machines.events import FoundMessage
from dynpf_runtime.machines.ledger import Ledger
from dynpf_runtime.machines.window import end_of

__all__ = ["rebuilt"]

_GAP_TOPIC = "recorder/gap"
_RESTART_TOPIC = "recorder/restart"


def rebuilt(
    found: Iterable[FoundMessage],
    ledger: Ledger,
    topics: Mapping[str, Topic],
    boots: Mapping[str, str],
    starts: dict[str, str],
    *,
    anew: bool,
) -> Iterator[Effect]:
    """Give the messages of a recording to an empty ledger, and yield what is to be written again.

    ``starts`` takes the last start of each node that the recording tells. Raises RunError if it is not of the nodes
    with these ``boots``.

    If ``anew``, all nodes are gone, and make their last steps anew, too: the run may have been stopped there, and is to
    go on. If it was over, it is over again.
    """
    ledger.patient = True  # what the file lacks is said again, and what comes after it, too
    steps: Counter[str] = Counter()  # the recording keeps no ticks but in the journal
    source, over = ledger.source, set[str]()
    for message in found:
        topic, envelope, payload = message
        node = source if envelope.node == LOG_NODE else envelope.node
        if node == RECORDER:
            if topic != _GAP_TOPIC:  # the writer finds gaps again
                yield Record(*message)
            if topic == _RESTART_TOPIC:
                starts.update(_told(payload))
            continue
        starts.setdefault(node, envelope.boot)
        if boots.get(node, envelope.boot) != envelope.boot:
            raise RunError(
                f"the recording has messages of another start of {node} ({envelope.boot}) than this run's "
                f"({boots[node]}): it is of another run; choose another name"
            )
        if node in over:
            continue
        try:
            if topic == JOURNAL_PREFIX + node:
                entry = decode_entry(payload)
                if entry.last and anew:
                    over.add(node)
                    continue
                placed = msgspec.structs.replace(envelope, tick=entry.tick)
                yield from ledger.end(end_of(placed, entry))
                yield from ledger.entry(placed, entry, payload)
                steps[node] = entry.step + 1
            elif topic in topics:
                yield from ledger.message(topic, node, msgspec.structs.replace(envelope, tick=steps[node]), payload)
        except (ProtocolError, msgspec.DecodeError):
            continue  # it was taken before as what it is now: a repetition, or nothing of the run
    ledger.forget_open()
    yield Mend()


def _told(payload: bytes) -> dict[str, str]:
    """Return the node that a recorder has told to be started again, and by which start."""
    try:
        restart = decode(_RESTART_TOPIC, payload)
    except ProtocolError:
        return {}
    assert isinstance(restart, Restart)
    return {} if restart.node in (RECORDER, ROUTER) else {restart.node: restart.start}
