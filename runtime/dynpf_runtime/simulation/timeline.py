"""The timeline: what happened in a simulated run, one line each, without what happens in every tick."""

from collections.abc import Iterator

from dynpf_protocol.control import TickDone, decode_control
from dynpf_protocol.keys import ALIVE, READY, RECORDED, STOP, TICK

from dynpf_runtime.machines.effects import Close, Declare, Ended, Put, Tell
from dynpf_runtime.machines.events import Dropped, RouterGone, StopAsked, Token
from dynpf_runtime.simulation.trial import Trial

__all__ = ["timeline"]

_EVERY = 10
"""Every so many ticks a line says how far the run is."""


def timeline(trial: Trial, source: str) -> Iterator[str]:
    """Yield the lines of a trial's story: moment, process, what happened. ``source`` is the node that leads the run."""
    following = 0
    for at_ns, process, what in trial.simulation.story:
        text = _text(what)
        if type(what) is Put and what.key == TICK + source:
            tick = decode_control(what.payload, TickDone).tick
            if tick >= following:
                text, following = f"has ended tick {tick}", tick + _EVERY
        if text:
            yield f"{at_ns / 1e9:10.6f} s  {process:<12} {text}"


def _text(what: object) -> str:
    match what:
        case str() | Tell():
            return what if isinstance(what, str) else f"tells: {what.text}"
        case Ended(error):
            return "ends" if error is None else f"ends: {error or type(error).__name__}"
        case Token(key, present):
            name = key.removeprefix(ALIVE).removeprefix(READY)
            return "" if present or key.startswith(READY) else f"sees that {name} is gone"
        case RouterGone():
            return "has lost the router"
        case StopAsked(reason, at_once):
            return f"is asked to end{' at once' if at_once else ''}: {reason}"
        case Dropped():
            return str(what.error)
        case Close(complete, reason):
            return f"closes the recording: {'complete' if complete else 'incomplete'}, {reason}"
        case Declare(key):
            return "is ready" if key.startswith(READY) else "is alive"
        case Put(key):
            if key == RECORDED:
                return "says that the recording is closed"
            return "asks the others to end the run" if key.startswith(STOP) else ""
    return ""
