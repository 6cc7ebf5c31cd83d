"""Turns: when a node is woken."""

from dynpf_runtime.inbox import RealtimeInbox
from dynpf_runtime.machines.effects import NEVER_NS
from dynpf_runtime.machines.turns import FollowRealtime


class Due(RealtimeInbox):
    """An inbox whose next message is due."""

    def __init__(self) -> None:
        """Hold nothing else."""

    def due_ns(self) -> int:
        return 5


def test_a_node_that_may_not_step_yet_is_not_woken_by_what_it_could_step_on() -> None:
    turns = FollowRealtime(Due())
    assert turns.wake_ns == 5
    assert turns.take(7, idle=True, stopping=False, held=True) is None
    assert turns.wake_ns == NEVER_NS, "it spins"
