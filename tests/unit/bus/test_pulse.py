"""Pulses, and the heartbeats that a process publishes while its main loop cannot."""

import time
from pathlib import Path

import pytest
from dynpf_protocol.control import Beat, Doing, decode_control, encode_control
from dynpf_protocol.keys import BEAT
from dynpf_runtime.bus.edge import late_beat
from dynpf_runtime.bus.pulse import Pulse, Reading
from dynpf_runtime.machines.effects import Put

BEATEN = Put(f"{BEAT}estimator", encode_control(Beat("estimator", "boot", 3)))


def test_another_process_reads_what_a_loop_does(tmp_path: Path) -> None:
    watched, watching = (Pulse.shared(tmp_path / "estimator.pulse") for _ in range(2))
    watched.step(7)
    seen = watching.read()
    assert (seen.doing, seen.tick) == (Doing.STEP, 7)
    assert 0 <= time.monotonic_ns() - seen.since_ns < 60 * 10**9


@pytest.mark.parametrize("doing", [Doing.TURNING, Doing.STEP, Doing.FILE])
def test_a_late_heartbeat_tells_what_the_loop_does_instead(doing: Doing) -> None:
    for_ns = 2 * 10**9
    late = late_beat(BEATEN, Reading(doing, 10**9, 4, 9), 10**9 + for_ns)
    assert late is not None
    assert late.key == BEATEN.key
    assert decode_control(late.payload, Beat) == Beat("estimator", "boot", 3, doing, for_ns)


def test_a_heartbeat_that_is_not_late_is_not_said_again() -> None:
    assert late_beat(BEATEN, Reading(Doing.STEP, 10**9, 4, 9), 10**9 + 5 * 10**8) is None


def test_a_loop_that_waits_for_the_bus_is_not_followed_by_another_message() -> None:
    assert late_beat(BEATEN, Reading(Doing.BUS, 10**9, 4, 9), 10**11) is None
