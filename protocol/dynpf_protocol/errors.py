"""Errors of the protocol, and errors for people: where, which value, what was expected, what to do."""

__all__ = [
    "BROKEN_OFF",
    "BadEnvelopeError",
    "BadMessageError",
    "BrokenOffError",
    "DiedAgainError",
    "DynpfError",
    "OrderError",
    "ProtocolError",
    "RepeatError",
    "RunError",
    "ScenarioError",
    "StepError",
    "TooLargeError",
    "UnknownSenderError",
    "UnknownTopicError",
    "UsageError",
]


class ProtocolError(Exception):
    """A message, an envelope or a topic breaks the protocol; the text says where and what."""


class BadMessageError(ProtocolError):
    """A payload does not fit its topic's type."""


class BadEnvelopeError(ProtocolError):
    """A message has no readable envelope."""


class UnknownTopicError(ProtocolError):
    """A topic is not in the topic table."""


class UnknownSenderError(ProtocolError):
    """A message is not due from its sender, or comes from another start of that process than this run's."""


class OrderError(ProtocolError):
    """A message is not one of those that its sender may send next: a repetition, or ahead of its sender."""


class RepeatError(OrderError):
    """A message has come before: a process that has been cut off, or started again, says once more what it had said."""


class TooLargeError(BadMessageError):
    """A message is larger than its topic allows."""


BROKEN_OFF = 3
"""Exit code of a process that ended because of another, by which ``dynpf run`` finds the one that failed first."""


class DynpfError(Exception):
    """An error whose text a command prints to stderr; ``exit_code`` is the command's exit code."""

    exit_code = 2


class UsageError(DynpfError):
    """The command was called in a way that cannot work."""


class ScenarioError(DynpfError):
    """A scenario file, or an override of it, is invalid."""


class RunError(DynpfError):
    """A run failed."""

    exit_code = 1


class DiedAgainError(RunError):
    """A process has died twice in the same step, by itself: it would do so again."""

    def __init__(self, text: str, node: str, tick: int) -> None:
        super().__init__(text)
        self.node, self.tick = node, tick


class StepError(RunError):
    """A node raised in its step; ``__cause__`` is its exception."""


class BrokenOffError(RunError):
    """The run broke off because of another process: a peer or the router is gone."""

    exit_code = BROKEN_OFF
