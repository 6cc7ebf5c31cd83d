"""Heartbeats: who hangs, and who only takes long."""

import msgspec
import pytest
from dynpf_protocol.control import Beat, Doing
from dynpf_protocol.errors import BrokenOffError
from dynpf_runtime.machines.heartbeats import BEAT_NS, NOTICE_NS, SILENT_NS, STEP_NS, WEDGED_NS, Heartbeats

PEERS = {"estimator": "boot"}


class Heard:
    """Heartbeats of one peer, which a process looks at twice a second."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.heartbeats = Heartbeats()

    def look(self, for_ns: int, beat: Beat | None = None) -> list[str]:
        """Return the notices while ``for_ns`` pass; the peer beats with ``beat``, or not at all."""
        told: list[str] = []
        until_ns = self.now_ns + for_ns
        while self.now_ns < until_ns:
            self.now_ns += BEAT_NS
            if beat is not None:
                self.heartbeats.take(msgspec.structs.replace(beat, for_ns=beat.for_ns and self.now_ns), self.now_ns)
            told += self.heartbeats.look(PEERS, self.now_ns)
        return told


def peer(doing: Doing = Doing.TURNING, for_ns: int = 0) -> Beat:
    return Beat("estimator", "boot", 3, doing, for_ns)


def test_a_peer_whose_loop_goes_round_is_not_mentioned() -> None:
    assert Heard().look(10 * SILENT_NS, peer()) == []


def test_a_main_loop_that_stands_still_is_named_within_three_seconds() -> None:
    heard = Heard()
    with pytest.raises(BrokenOffError, match=r"estimator hangs: its main loop has stood still for 3\.0 s"):
        heard.look(10 * WEDGED_NS, peer(Doing.TURNING, 1))
    assert heard.now_ns <= 3 * 10**9


def test_a_long_step_is_told_ever_more_rarely_and_is_no_hang_until_its_limit() -> None:
    heard = Heard()
    told = heard.look(60 * 10**9, peer(Doing.STEP, 1))
    assert told == [f"estimator has been in the step of tick 3 for {seconds} s" for seconds in (5, 10, 20, 40)]
    with pytest.raises(BrokenOffError, match="estimator hangs: it has been in the step of tick 3 for 600 s"):
        heard.look(STEP_NS, peer(Doing.STEP, 1))


def test_a_peer_that_starts_or_compiles_has_no_main_loop_that_could_stand_still() -> None:
    assert Heard().look(10 * WEDGED_NS, peer(Doing.STARTING, 1)) == []


def test_a_present_peer_that_says_nothing_is_told_and_then_said_to_hang() -> None:
    heard = Heard()
    heard.look(BEAT_NS, peer())
    assert heard.look(SILENT_NS) == [f"estimator has said nothing for {seconds} s" for seconds in (5, 10)]
    with pytest.raises(BrokenOffError, match="estimator hangs: it has said nothing for 15 s"):
        heard.look(BEAT_NS)


def test_who_was_held_up_himself_gives_the_others_their_time_anew() -> None:
    heard = Heard()
    heard.look(BEAT_NS, peer())
    heard.now_ns += 2 * SILENT_NS
    assert heard.look(NOTICE_NS) == []
