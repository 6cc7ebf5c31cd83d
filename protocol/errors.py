"""Errors of what travels: a message, an envelope or a topic that cannot be accepted."""

__all__ = ["BadEnvelopeError", "BadMessageError", "ProtocolError", "UnknownTopicError"]


class ProtocolError(Exception):
    """Something that travels between processes breaks the protocol; the text says where, what and what to do."""


class BadMessageError(ProtocolError):
    """A payload does not hold what its topic promises."""


class BadEnvelopeError(ProtocolError):
    """A message came without a readable envelope."""


class UnknownTopicError(ProtocolError):
    """A topic is not in the topic table."""
