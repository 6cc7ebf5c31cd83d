"""Rivals: other starts of a process under its name, at the same time."""

from collections import deque

from dynpf_runtime.machines.roster import MOST_STARTS

__all__ = ["Rivals"]


class Rivals:
    """The rivals of a process that is not ready yet."""

    def __init__(self) -> None:
        self.present: set[str] = set()
        self._ready: deque[str] = deque(maxlen=MOST_STARTS)

    def take(self, start: str, own: str, *, ready: bool, present: bool) -> bool:
        """Note a token of a rival; return whether the process ``own`` gives way to it.

        It does to one that is ready or has the smaller start, so that exactly one stays.
        """
        if not present:
            if not ready:
                self.present.discard(start)
            return False
        if ready:
            self._ready.append(start)  # its token of life may still come, by another subscription
        else:
            self.present.add(start)
        return start in self.present and (start in self._ready or start < own)
