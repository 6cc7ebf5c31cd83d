"""Recalling: the recorder's answers to the new start of a node, which asks for what its predecessor has read and done.

In lockstep they are what the nodes upstream have said, from which all follows. In realtime they are the journal. There
a step that the recorder does not know of is lost: what others have read of it nobody can do again, and another step in
its place would be another truth. So the recorder first waits until all that others have read until then is here.
"""

from collections.abc import Callable, Iterator

from dynpf_protocol.errors import OrderError, UnknownSenderError
from dynpf_protocol.keys import RECALL, RECALLED
from dynpf_protocol.recall import Recall, Recalled, decode_recall, encode_recall
from dynpf_protocol.topics import is_record

from dynpf_runtime.machines.absence import LAST_WORD_NS
from dynpf_runtime.machines.effects import Put
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.ledger import Ledger
from dynpf_runtime.machines.membership import Membership
from dynpf_runtime.machines.realtime_window import RealtimeWindow
from dynpf_runtime.machines.roles import check_boot
from dynpf_runtime.machines.roster import follows
from dynpf_runtime.machines.window import Part, Window

__all__ = ["Recalling"]

_PATIENCE_NS = 5_000_000_000
"""How long to wait, in realtime, for what others have read and not said yet."""

_TOO_MUCH = "too much has been recorded for it to do it all again"


class Recalling:
    """The answers of the recorder, a ``member`` of the run, by what its ``ledger`` knows."""

    def __init__(self, member: Membership, ledger: Ledger) -> None:
        self._member, self._ledger = member, ledger
        self._asked: dict[str, int] = {}  # when a start has first asked
        self._early: dict[str, Arrived] = {}

    def early(self) -> list[Arrived]:
        """Return the questions of those whose tokens had not come, to be heard again."""
        early, self._early = list(self._early.values()), {}
        return early

    def hear(self, arrived: Arrived, gone_ns: Callable[[str], int], now_ns: int) -> Iterator[Put]:
        """Answer a node whose predecessor was gone at ``gone_ns``, unless it is to ask again; raises ProtocolError."""
        asked, starts = decode_recall(arrived.payload), self._member.starts
        if asked.node != arrived.key[len(RECALL) :]:
            raise UnknownSenderError(f"it comes in the name of {asked.node!r}; its key is another's")
        if follows(asked.start, starts.get(asked.node, "")):
            self._early[asked.node] = arrived  # its token is still on its way here
            return
        check_boot(asked.node, asked.start, starts)
        if asked.node not in self._ledger.names:
            raise OrderError(f"{asked.node} is no node of this run")
        answer = self._answer(asked, gone_ns(asked.node), now_ns)
        if answer is not None:
            yield Put(RECALLED + asked.node, encode_recall(answer))

    def _answer(self, asked: Recall, gone_ns: int, now_ns: int) -> Recalled | None:
        window = self._ledger.window
        if isinstance(window, Window):
            part = window.part(asked.node, asked.tick)
            return self._recalled(asked, part, "" if part.whole else _TOO_MUCH)
        patient = now_ns < self._asked.setdefault(asked.start, now_ns) + _PATIENCE_NS
        # Its last messages may come after its token has gone, and what others have read of them after that.
        if now_ns < gone_ns + LAST_WORD_NS or (patient and self._waits(asked.node, gone_ns)):
            return None
        return self._in_realtime(asked, window, patient=patient)

    def _waits(self, name: str, gone_ns: int) -> bool:
        """Return whether steps of others are still to come that they made before a node was gone, or soon after."""
        member, ledger = self._member, self._ledger
        for peer in member.present - {name}:
            heard = member.heartbeats.heard(peer)
            if peer in ledger.names and (heard is None or heard.at_ns < gone_ns):
                return True
            if peer in ledger.names and heard is not None and heard.beat.ticks > ledger.place(peer).written:
                return True
        return False

    def _in_realtime(self, asked: Recall, window: RealtimeWindow, *, patient: bool) -> Recalled | None:
        name, ledger = asked.node, self._ledger
        ledger.forget_lost(name)
        following, numbers = ledger.entered(name)
        until = ledger.place(name).written + len(following)
        part = window.part(name, asked.tick, following, until)
        if topic := window.read_beyond(name, numbers):
            text = f"others have read messages of it on {topic} of which no journal is left; the recorder was gone, too"
            return self._recalled(asked, Part((), (), asked.tick, False), text)
        if part is None:
            if patient:
                return None
            part = Part((), (), asked.tick, False, whole=False)
        return self._recalled(asked, part, "" if part.whole else _TOO_MUCH)

    def _recalled(self, asked: Recall, part: Part, lacking: str) -> Recalled:
        ledger, member = self._ledger, self._member
        place = ledger.place(asked.node)
        records = {} if ledger.source != asked.node else ledger.entered(asked.node)[1]
        numbers = {topic: number for topic, number in records.items() if is_record(topic)}
        return Recalled(
            start=member.start,
            to=asked.start,
            tick=asked.tick,
            next_tick=part.next_tick,
            more=part.more,
            lacking=lacking,
            written=place.written,
            said=place.said,
            last=place.last,
            stop_reason=member.stop_reason,
            sequences=place.numbers | numbers,
            entries=part.entries,
            pieces=part.pieces,
            snapshot=part.snapshot,
        )
