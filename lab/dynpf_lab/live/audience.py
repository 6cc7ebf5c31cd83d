"""The audience of a run: browsers that look on, each with what it has not been sent yet.

Of frames only the newest waits, so that a slow browser sees fewer, and a stalled one holds nothing up.
"""

import json
import threading
from collections import deque
from typing import Any, NamedTuple

__all__ = ["Audience", "Seat"]

MOST_SEATS = 32
MOST_SAID = 100
"""Texts that wait for a browser, and that a new one is told of the time before it came."""


class _Shown(NamedTuple):
    """What is shown now; numbers go up when it changes."""

    begin: bytes
    stays: bytes = b""
    stays_number: int = 0
    frame: bytes = b""
    frame_number: int = 0
    end: bytes = b""


class Seat:
    """A browser's place: how much of what is shown it has been sent."""

    def __init__(self) -> None:
        self.said: deque[bytes] = deque(maxlen=MOST_SAID)
        self.began = False
        self.stays = self.frame = 0
        self.end = b""


class Audience:
    """Browsers, and what all of them are shown; used by the thread that follows the run and by one of each browser."""

    def __init__(self, begin: Any) -> None:
        self._changed = threading.Condition()
        self._shown = _Shown(_event("begin", begin))
        self._seats: set[Seat] = set()
        self._said: deque[bytes] = deque(maxlen=MOST_SAID)
        self._over = False

    def __len__(self) -> int:
        return len(self._seats)

    def enter(self) -> Seat | None:
        """Return a seat, None if all are taken."""
        with self._changed:
            if len(self._seats) >= MOST_SEATS or self._over:
                return None
            seat = Seat()
            seat.said.extend(self._said)
            self._seats.add(seat)
            return seat

    def leave(self, seat: Seat) -> None:
        """Give a seat up."""
        with self._changed:
            self._seats.discard(seat)

    def show(self, frame: Any, stays: Any) -> None:
        """Show a frame, and what stays from frame to frame, which is sent only when it is another than before."""
        with self._changed:
            shown, fixed = self._shown, _event("stays", stays)
            if fixed != shown.stays:
                shown = shown._replace(stays=fixed, stays_number=shown.stays_number + 1)
            self._shown = shown._replace(frame=_event("frame", frame), frame_number=shown.frame_number + 1)
            self._changed.notify_all()

    def say(self, text: Any) -> None:
        """Tell everybody something; a browser that takes nothing misses the oldest."""
        with self._changed:
            event = _event("said", text)
            self._said.append(event)
            for seat in self._seats:
                seat.said.append(event)
            self._changed.notify_all()

    def end(self, end: Any) -> None:
        """Tell that the run is over, or where its page is."""
        with self._changed:
            self._shown = self._shown._replace(end=_event("end", end))
            self._changed.notify_all()

    def close(self) -> None:
        """Send everybody away."""
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def next(self, seat: Seat, timeout_s: float) -> bytes | None:
        """Return what a browser has to be sent next, b"" if nothing comes in time, None if there is no more."""
        with self._changed:
            if (found := self._take(seat)) or self._over:
                return found or None
            self._changed.wait(timeout_s)
            return self._take(seat) or (None if self._over else b"")

    def _take(self, seat: Seat) -> bytes:
        shown, events = self._shown, []
        if not seat.began:
            seat.began = True
            events.append(shown.begin)
        if seat.stays != shown.stays_number:
            seat.stays = shown.stays_number
            events.append(shown.stays)
        if seat.frame != shown.frame_number:
            seat.frame = shown.frame_number
            events.append(shown.frame)
        events += seat.said
        seat.said.clear()
        if seat.end != shown.end:
            seat.end = shown.end
            events.append(shown.end)
        return b"".join(events)


def _event(name: str, data: Any) -> bytes:
    """Return a server-sent event."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return f"event: {name}\ndata: {text}\n\n".encode()
