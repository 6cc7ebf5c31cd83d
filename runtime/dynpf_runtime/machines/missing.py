"""Missing peers: whom a process that assembles tells that it waits for."""

from collections.abc import Collection, Iterator

from dynpf_runtime.machines.effects import Tell

__all__ = ["MissingNotice"]

_PATIENCE_NS = 1_000_000_000  # after that a notice lists the missing peers


class MissingNotice:
    """The notice, once for each set of peers."""

    def __init__(self) -> None:
        self.wake_ns = 0
        self._noticed: set[str] = set()

    def after(self, now_ns: int) -> None:
        """Begin to wait."""
        self._noticed, self.wake_ns = set(), now_ns + _PATIENCE_NS

    def tell(self, what: str, names: Collection[str], now_ns: int) -> Iterator[Tell]:
        """Tell whom this process waits for, if it has waited long enough."""
        if names and now_ns >= self.wake_ns and set(names) != self._noticed:
            self._noticed = set(names)
            yield Tell(f"{what} {', '.join(sorted(names))}")
