"""Admission: whether a process has the scenario that the router runs."""

from dynpf_protocol.errors import RunError, UsageError
from dynpf_protocol.keys import SCENARIO
from dynpf_protocol.printable import printable

from dynpf_runtime.machines.agreement import first_difference
from dynpf_runtime.machines.effects import NEVER_NS, Ask

__all__ = ["Admission"]

_ANSWER_NS = 5_000_000_000
_ASK_AGAIN_NS = 20_000_000  # Zenoh reports at once that no one answers yet
_DIFFERS_NS = 3_000_000_000  # how long another scenario has to be the answer, and ours not among the answers


class Admission:
    """The question of the process ``name`` whether its resolved scenario ``text`` is that of the router."""

    def __init__(self, name: str, text: str, endpoint: str) -> None:
        self.wake_ns = NEVER_NS  # when to ask again
        self._name, self._text, self._endpoint = name, text, endpoint
        self._ask_until_ns: int | None = None
        self._differ_at_ns = NEVER_NS

    def ask(self, now_ns: int) -> Ask:
        """Return the question."""
        if self._ask_until_ns is None:
            self._ask_until_ns = now_ns + _ANSWER_NS
        self.wake_ns = NEVER_NS
        return Ask(SCENARIO, self._text.encode())

    def wait_for_router(self) -> None:
        """Give the router its whole time again: it is gone, and can answer once it is back."""
        self._ask_until_ns = None

    def answered(self, theirs: bytes | None, now_ns: int) -> bool:
        """Return whether the process fits by the router's answer; if not yet, it asks again.

        Raises UsageError if it does not fit, RunError if the router does not answer.
        """
        router = f"the router at {self._endpoint}"
        if theirs is None:
            if self._ask_until_ns is not None and now_ns > self._ask_until_ns:
                raise RunError(
                    f"{router} does not say which scenario it runs; is it a dynpf router, and is {self._name}'s key "
                    "not revoked?"
                )
            self.wake_ns = now_ns + _ASK_AGAIN_NS
            return False
        if theirs != self._text.encode() and now_ns < self._differ_at_ns:
            # It may be a stranger's, who was there before the router had begun to answer.
            self._differ_at_ns = min(self._differ_at_ns, now_ns + _DIFFERS_NS)
            self.wake_ns = now_ns + _ASK_AGAIN_NS
            return False
        try:
            difference = first_difference(self._text, theirs.decode())
        except (ValueError, RecursionError) as error:  # the text is only compared: user code in it is never imported
            reason = printable(str(error))
            raise RunError(f"{router} sent a scenario that cannot be read: {reason}") from error
        if difference is not None:
            key, here, there = difference
            raise UsageError(
                f"refused: this scenario differs from the router's in {printable(key)}: "
                f"here {printable(repr(here))}, there {printable(repr(there))}"
            )
        return True
