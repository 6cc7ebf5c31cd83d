"""The router: the hub of a run, which knows its scenario and when the run is over."""

from collections.abc import Iterator

from dynpf_protocol.control import Beat, Recorded, Stop, decode_control, encode_control
from dynpf_protocol.errors import BrokenOffError, ProtocolError
from dynpf_protocol.keys import ALIVE, BEAT, CONTROL, READY, RECORDED, RECORDER, ROUTER, SCENARIO, STOP
from dynpf_protocol.printable import printable

from dynpf_runtime.machines.effects import NEVER_NS, Answer, Declare, Effect, Ended, Put, Subscribe, Tell, Watch
from dynpf_runtime.machines.events import Arrived, Dropped, Event, Now, Started, StopAsked, Token
from dynpf_runtime.machines.heartbeats import BEAT_NS
from dynpf_runtime.machines.absence import LAST_WORD_NS
from dynpf_runtime.machines.refusals import Refusals, known_names
from dynpf_runtime.machines.roles import check_boot
from dynpf_runtime.machines.roster import Roster, holder
from dynpf_runtime.plan import Plan

__all__ = ["RouterMachine"]

NOTICE_NS = 5_000_000_000
"""After this, and then ever twice as long, the router says whom the run waits for."""


class RouterMachine:
    """Answers queries for the resolved scenario of ``plan``, until it has ended and all its processes have left."""

    def __init__(self, plan: Plan, start: str) -> None:
        self.wake_ns = 0
        self._scenario = plan.text
        self._boot = start
        self._roster = Roster({*plan.graph.nodes, RECORDER})
        self._refusals = Refusals(known_names(plan))
        self._recorded: Recorded | None = None
        self._began = False
        self._left_ns = NEVER_NS  # when the last process left without a word of the recorder
        self._stopping = False
        self._began_ns = NEVER_NS  # when this process started
        self._notice_at_ns = 0

    def handle(self, event: Event, now: Now) -> Iterator[Effect]:
        """Yield the effects of an event. It ends with BrokenOffError if the run was not recorded completely."""
        match event:
            case Started():
                self._began_ns, self._notice_at_ns = now.monotonic_ns, now.monotonic_ns + NOTICE_NS
                yield Answer(SCENARIO, self._scenario.encode())
                yield from (Subscribe(f"{CONTROL}**"), Watch(f"{ALIVE}**"), Watch(f"{READY}**"))
                yield Declare(f"{ALIVE}{ROUTER}/{self._boot}")
            case Token():
                self._token(event)
            case Arrived(key) if key == RECORDED:
                yield from self._hear(event, now)
            case Dropped(key):
                yield from self._refuse(key, event.error, now)
            case StopAsked():
                if event.at_once or not self._began:
                    yield Ended(KeyboardInterrupt())
                    return
                if not self._stopping:
                    self._stopping = True
                    yield Put(f"{STOP}{ROUTER}", encode_control(Stop(ROUTER, self._boot, event.reason)))
        if self._over(now):
            yield Ended(self._outcome())
        elif now.monotonic_ns >= self.wake_ns:
            self.wake_ns = now.monotonic_ns + BEAT_NS
            yield Put(f"{BEAT}{ROUTER}", encode_control(Beat(ROUTER, self._boot, 0)))
            yield from self._notify_missing(now.monotonic_ns)

    def _over(self, now: Now) -> bool:
        """Return whether everybody has left, the recorder with its last word or without one."""
        if not self._began or self._roster.present:
            self._left_ns = NEVER_NS
            return False
        if self._recorded is None and self._left_ns == NEVER_NS:
            self._left_ns = now.monotonic_ns
            self.wake_ns = min(self.wake_ns, now.monotonic_ns + LAST_WORD_NS)
        return self._recorded is not None or now.monotonic_ns >= self._left_ns + LAST_WORD_NS

    def _notify_missing(self, now_ns: int) -> Iterator[Tell]:
        """Say, ever more rarely, for whom the run waits and since when; they may have been refused."""
        if self._began or now_ns < self._notice_at_ns:
            return
        waited_ns = now_ns - self._began_ns
        self._notice_at_ns = now_ns + waited_ns
        missing = sorted(self._roster.names - self._roster.present)
        if missing:
            yield Tell(f"the run has waited for {', '.join(missing)} for {waited_ns // 10**9} s; Ctrl-C ends it")

    def _token(self, token: Token) -> None:
        """Note who is there. Nobody is ready before all are alive, whatever a stranger's token says."""
        roster = self._roster
        if holder(token)[0] in roster.names:
            roster.take(token)
            self._began = self._began or (roster.starts.keys() == roster.names and bool(roster.ready))

    def _hear(self, arrived: Arrived, now: Now) -> Iterator[Effect]:
        try:
            recorded = decode_control(arrived.payload, Recorded)
            check_boot(RECORDER, recorded.boot, self._roster.starts)
            self._recorded = recorded
        except ProtocolError as error:
            yield from self._refuse(arrived.key, error, now)

    def _refuse(self, key: str, error: ProtocolError, now: Now) -> Iterator[Tell]:
        text = self._refusals.note(key, error, now.monotonic_ns)
        if text is not None:
            yield Tell(text)

    def _outcome(self) -> BrokenOffError | None:
        if self._recorded is None:
            return BrokenOffError("all processes left before the run was recorded")
        if not self._recorded.complete:
            return BrokenOffError(f"the run ended incomplete: {printable(self._recorded.reason)}")
        return None
