"""The edge: what becomes of a machine's questions that the bus refuses to ask."""

from collections.abc import Iterable
from pathlib import Path
from typing import cast

import pytest
import zenoh
from dynpf_runtime.bus import edge
from dynpf_runtime.bus.edge import drive
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import StopSignal
from dynpf_runtime.machines.effects import NEVER_NS, Ask, Count, Effect, Ended
from dynpf_runtime.machines.events import Answered, Counted, Event, Now, RouterGone, Started


class Refusing:
    """A bus that refuses the first questions, as when the router has just gone."""

    connected, waiting = True, False

    def __init__(self, refused: int, clock: "Clock") -> None:
        self.left, self.clock = refused, clock

    def ask(self, key: str, wanted: bytes) -> bytes:
        self._refuse()
        return key.encode() + wanted

    def tokens(self, key: str) -> tuple[str, ...]:
        self._refuse()
        return (key,)

    def receive(self, timeout_s: float) -> None:
        assert timeout_s < 60, "nobody wakes it again"
        self.clock.now_ns += max(0, round(timeout_s * 1e9))

    def wake(self) -> None:
        pass

    def _refuse(self) -> None:
        self.left -= 1
        if self.left >= 0:
            raise zenoh.ZError("the session is closed")


class Clock:
    """Time that passes while the bus is waited for."""

    def __init__(self) -> None:
        self.now_ns = 0

    def monotonic_ns(self) -> int:
        """See time."""
        return self.now_ns

    time_ns = monotonic_ns


class Asking:
    """A machine that asks, and waits for nothing but the answer."""

    wake_ns = NEVER_NS

    def __init__(self, question: Ask | Count) -> None:
        self.question = question
        self.heard: list[Event] = []

    def handle(self, event: Event, _now: Now) -> Iterable[Effect]:
        if type(event) is Started:
            return (self.question,)
        if isinstance(event, Answered | Counted | RouterGone):
            self.heard.append(event)
        return (Ended(),) if isinstance(event, Answered | Counted) else ()


@pytest.mark.parametrize("refused", [0, 2])
@pytest.mark.parametrize(
    ("question", "answer"),
    [(Ask("scenario", b"?"), Answered(b"scenario?")), (Count("alive/*"), Counted("alive/*", ("alive/*",)))],
)
def test_what_the_bus_refuses_to_ask_is_asked_again_until_it_is_answered(
    question: Ask | Count, answer: Event, refused: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, clock = Asking(question), Clock()
    monkeypatch.setattr(edge, "time", clock)
    bus = cast("Bus", Refusing(refused, clock))
    drive("estimator", machine, bus, StopSignal(), pulse=Pulse.shared(tmp_path / "pulse"))
    assert clock.now_ns == pytest.approx(refused * 10**8)
    assert machine.heard[-1] == answer
    assert machine.heard[:-1] == [RouterGone()] * refused
