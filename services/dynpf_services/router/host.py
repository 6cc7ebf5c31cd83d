"""The router process: a Zenoh session in router mode that knows which scenario is run through it."""

import time

from dynpf_protocol.control import Beat, Recorded, Stop, decode_control, encode_control
from dynpf_protocol.errors import BrokenOffError, ProtocolError
from dynpf_runtime.bus.member import BEAT_S, StopSignal, new_boot, say
from dynpf_runtime.bus.session import ALIVE, BEAT, CONTROL, READY, SCENARIO, open_router

__all__ = ["run_router"]


def run_router(scenario: str, endpoint: str, stop: StopSignal, *, quiet: bool) -> None:
    """Be the hub at ``endpoint`` until the run of ``scenario``, a resolved one, has ended and everybody has left.

    Raises UsageError if it cannot listen there, BrokenOffError if everybody left before the run was recorded.
    """
    boot = new_boot()
    with open_router(endpoint) as bus:
        stop.wakes(bus)
        bus.answer(SCENARIO, scenario.encode())
        bus.subscribe(f"{CONTROL}*")
        bus.watch(f"{ALIVE}**")
        bus.watch(f"{READY}**")
        bus.declare(f"{ALIVE}router/{boot}")
        if not quiet:
            say("router", f"listening at {endpoint}")
        present: set[str] = set()
        began = stopping = False
        recorded: Recorded | None = None
        next_beat = 0.0
        while not (began and not present):
            now = time.monotonic()
            if now >= next_beat:
                next_beat = now + BEAT_S
                bus.put(f"{BEAT}router", encode_control(Beat("router", boot, 0)))
            arrival = bus.receive(max(next_beat - now, 0.0))
            if stop.requested and (stop.at_once or not began):
                raise KeyboardInterrupt
            if stop.requested and not stopping:
                stopping = True
                bus.put(f"{CONTROL}stop", encode_control(Stop("router", stop.reason)))
            if arrival is None or not arrival.key:
                continue
            if arrival.key.startswith(ALIVE) and not arrival.key.startswith(f"{ALIVE}router/"):
                (present.add if arrival.present else present.discard)(arrival.key)
            elif arrival.key.startswith(READY):
                began = True
            elif arrival.key == f"{CONTROL}recorded":
                try:
                    recorded = decode_control(arrival.payload, Recorded)
                except ProtocolError as error:
                    say("router", f"{arrival.key}: message refused: {error}")
        if recorded is None:
            raise BrokenOffError("everybody has left before the run was recorded")
        if not recorded.complete:
            raise BrokenOffError(f"the run ended incomplete: {recorded.reason}")
