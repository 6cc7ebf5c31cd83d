"""Errors of what travels, and errors whose text is for a person: where, which value, what was expected, what to do."""

__all__ = [
    "BROKEN_OFF",
    "BadEnvelopeError",
    "BadMessageError",
    "BrokenOffError",
    "DynpfError",
    "ProtocolError",
    "RunError",
    "ScenarioError",
    "StepError",
    "UnknownTopicError",
    "UsageError",
]


class ProtocolError(Exception):
    """Something that travels between processes breaks the protocol; the text says where, what and what to do."""


class BadMessageError(ProtocolError):
    """A payload does not hold what its topic promises."""


class BadEnvelopeError(ProtocolError):
    """A message came without a readable envelope."""


class UnknownTopicError(ProtocolError):
    """A topic is not in the topic table."""


BROKEN_OFF = 3
"""Exit code by which ``dynpf run`` tells a process that followed the others from the one that failed first."""


class DynpfError(Exception):
    """An error told in one line on stderr; ``exit_code`` is what the command ends with."""

    exit_code = 2


class UsageError(DynpfError):
    """The command was called in a way that cannot work."""


class ScenarioError(DynpfError):
    """A scenario file, or an override of it, says something that it cannot say."""


class RunError(DynpfError):
    """A run could not be carried through."""

    exit_code = 1


class StepError(RunError):
    """A node has failed in its step: a bug, whose traceback ``__cause__`` carries."""


class BrokenOffError(RunError):
    """The run broke off for another process's sake: a peer or the router is gone."""

    exit_code = BROKEN_OFF
