"""Watching a run: hears it on the bus, shows it to an audience ten times a second, and passes on what a person asks.

A run waits for nobody who watches it: this process comes after the run's own on a busy machine, and what it hears
waits in a bounded queue.
"""

import os
import queue
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from dynpf_experiments.pictures.event import act_in_words
from dynpf_experiments.pictures.live import LiveRun
from dynpf_protocol.codec import decode
from dynpf_protocol.control import Act, Beat, Pace, Recorded, decode_control, encode_control
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.errors import ProtocolError, TooLargeError
from dynpf_protocol.keys import ACT, ALIVE, BEAT, DATA, OPERATOR, RECORDED, data_keys, topic_of
from dynpf_protocol.messages import Log, LogLevel
from dynpf_protocol.printable import printable
from dynpf_protocol.topics import Topic, is_act
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.plan import Plan
from msgspec.structs import replace

from dynpf_lab.live.audience import Audience
from dynpf_lab.live.wishes import Wish, checked

if TYPE_CHECKING:
    from dynpf_runtime.bus.session import Bus

__all__ = ["Watching", "acts_of_run", "come_second"]

FRAME_S = 0.1
LOOK_S = 0.02
"""How soon what a person asks for is passed on."""

GONE_S = 3.0
"""How long the router may be away before the run counts as over."""

SETTLE_S = 1.0
"""After a request, how long the source may go on saying that its pace is another."""

MOST_WISHES = 64
NICE = 5
"""What a run's own processes have to do comes first."""


def acts_of_run(plan: Plan) -> dict[str, Topic]:
    """Return the topics of acts that a run takes."""
    return {name: plan.graph.topics[name] for name in sorted(plan.graph.acts)}


class Watching:
    """A run of ``plan`` as ``audience`` sees it; an operator as the start ``boot``, or "" who only looks on."""

    def __init__(self, plan: Plan, live: LiveRun, audience: Audience, *, boot: str) -> None:
        self.ended: Recorded | None = None
        self._plan, self._live, self._audience, self._boot = plan, live, audience, boot
        self._acts = acts_of_run(plan)
        self._wishes: queue.Queue[Wish] = queue.Queue(MOST_WISHES)
        self._number = 0
        self._pace = Pace(rate=plan.rate or 0.0)  # as the source says, or as somebody has asked for here
        self._asked: Pace | None = None
        self._asked_s = 0.0
        self._start = ""  # of the source
        self._ticks = 0
        self._shown_s = 0.0
        self._told = 0
        self._listens = False

    def act(self, body: bytes) -> None:
        """Take what a person asks for, in any thread; raises ProtocolError if it cannot be."""
        wish = checked(body, self._acts)
        try:
            self._wishes.put_nowait(wish)
        except queue.Full:
            raise TooLargeError("too many requests wait already") from None

    def begin(self, bus: "Bus") -> None:
        """Listen to how the run goes, and be there as an operator."""
        for key in (f"{BEAT}{self._plan.graph.source}", RECORDED, data_keys("log"), data_keys("notice")):
            bus.subscribe(key)
        if self._boot:
            bus.declare(f"{ALIVE}{OPERATOR}/{self._boot}")

    def follow(self, bus: "Bus", stopped: Callable[[], bool]) -> None:
        """Follow the run until it is over, its router is gone, or ``stopped`` returns true."""
        gone_s = time.monotonic() + GONE_S
        while self.ended is None and not stopped():
            arrived = bus.receive(LOOK_S)
            while isinstance(arrived, Arrived):
                self._hear(arrived)
                if not self._wishes.empty() or time.monotonic() - self._shown_s >= FRAME_S:
                    break
                arrived = bus.receive(0.0)
            self._listen(bus)
            self._ask(bus)
            now_s = time.monotonic()
            if now_s - self._shown_s >= FRAME_S:
                self._shown_s = now_s
                gone_s = now_s + GONE_S if bus.connected else gone_s
                self.show()
            if now_s > gone_s:
                return

    def show(self) -> None:
        """Show the last moment, if anybody looks on."""
        if len(self._audience):
            moving, staying = self._live.frame()
            state = {"paused": self._pace.paused, "rate": self._pace.rate, "ticks": self._ticks}
            self._audience.show({**moving, "state": state}, staying)

    def _listen(self, bus: "Bus") -> None:
        """Listen to what the run says from when somebody looks on: before, it costs the router nothing."""
        if self._listens or not len(self._audience):
            return
        self._listens = True
        for topic in self._plan.graph.topics:
            if self._live.wants(topic):
                bus.subscribe(DATA + topic)

    def _hear(self, arrived: Arrived) -> None:
        try:
            if arrived.key.startswith(BEAT):
                self._beat(decode_control(arrived.payload, Beat))
            elif arrived.key == RECORDED:
                self.ended = decode_control(arrived.payload, Recorded)
            elif arrived.key.startswith(DATA):
                self._message(topic_of(arrived.key)[0], arrived)
        except ProtocolError:
            return  # on a plain bus it may be anybody's

    def _message(self, topic: str, arrived: Arrived) -> None:
        envelope = decode_envelope(arrived.attachment)
        if topic in {"log", "notice"}:
            said = decode(topic, arrived.payload)
            if isinstance(said, Log):
                level = "info" if said.level <= LogLevel.INFO else "warning"
                self._tell(level, envelope.stamp_ns, f"{said.name}: {said.message}")
            return
        self._live.hear(topic, envelope, arrived.payload)
        if is_act(topic):
            told = act_in_words(topic, decode(topic, arrived.payload, self._acts))
            self._tell("act", envelope.stamp_ns, f"{told}, in tick {envelope.tick}")

    def _tell(self, level: str, stamp_ns: int, text: str) -> None:
        self._told += 1
        self._audience.say(
            {"n": self._told, "level": level, "t": self._live.seconds(stamp_ns), "text": printable(text, 300)}
        )

    def _beat(self, beat: Beat) -> None:
        """Note how far the source is, and tell a new start of it the pace that its predecessor had been told."""
        if self._start not in ("", beat.boot) and self._asked is not None:
            with suppress(queue.Full):
                self._wishes.put_nowait(Wish(pace=replace(self._asked, steps=0)))
        elif beat.pace is not None and time.monotonic() > self._asked_s + SETTLE_S:
            self._pace = beat.pace
        self._start, self._ticks = beat.boot, beat.ticks

    def _ask(self, bus: "Bus") -> None:
        """Ask the source for what persons have asked for here."""
        while not self._wishes.empty():
            wish = self._wishes.get_nowait()
            if wish.pace is not None:
                self._pace = self._asked = wish.pace
                self._asked_s = time.monotonic()
            said = Act(OPERATOR, self._boot, self._number, wish.topic, bytes(wish.act), wish.pace)
            self._number += 1
            bus.put(ACT + OPERATOR, encode_control(said))


def come_second() -> None:
    """Let other processes go first; to be called before any thread is started."""
    os.nice(NICE)
