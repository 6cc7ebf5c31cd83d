"""Keys of messages, tokens and queries on the bus."""

__all__ = [
    "ACT",
    "AGAIN",
    "ALIVE",
    "BEAT",
    "CONTROL",
    "DATA",
    "JOURNAL",
    "OBSERVER",
    "OPERATOR",
    "READY",
    "RECALL",
    "RECALLED",
    "RECORDED",
    "RECORDER",
    "ROUTER",
    "RUN",
    "SAID_BY",
    "SCENARIO",
    "SHARED",
    "STOP",
    "TICK",
    "data_key",
    "data_keys",
    "topic_of",
]

RUN = "dynpf/run/"  # all that a recorder takes, by one subscription, which keeps the order of each sender's messages
DATA = "dynpf/run/data/"  # + topic, and of those that several processes write + SAID_BY + process
SAID_BY = "/-/"  # which stands in no topic
JOURNAL = "dynpf/run/journal/"  # + node
TICK = "dynpf/run/tick/"  # + node
AGAIN = "dynpf/run/again/"  # + node that says again, to the recorder alone, what was lost with another process
RECALL = "dynpf/run/recall/"  # + node that asks the recorder for what it has read
RECALLED = "dynpf/recalled/"  # + node that has asked, by the recorder alone
ACT = "dynpf/act/"  # + the operator, who asks the source for something
BEAT = "dynpf/beat/"  # + process
CONTROL = "dynpf/control/"
STOP = "dynpf/control/stop/"  # + process that asks for the end of the run
RECORDED = "dynpf/control/recorded"  # by the recorder alone
ALIVE = "dynpf/alive/"  # + process/boot, a liveliness token
READY = "dynpf/ready/"  # + process/boot, a liveliness token
SCENARIO = "dynpf/scenario"

ROUTER = "router"
RECORDER = "recorder"
OBSERVER = "observer"  # looks on, and sends nothing
OPERATOR = "operator"  # a person who may act on a simulated world, pause the run and end it

SHARED = frozenset({"log", "notice", "diagnostics"})
"""The topics that several processes write. Their keys name the process, so that nobody can speak in another's name."""


def data_key(topic: str, sender: str) -> str:
    """Return the key under which ``sender`` publishes on a topic."""
    return f"{DATA}{topic}{SAID_BY}{sender}" if topic in SHARED else DATA + topic


def data_keys(topic: str) -> str:
    """Return the expression for the keys of all messages on a topic."""
    return data_key(topic, "**")


def topic_of(key: str) -> tuple[str, str]:
    """Return the topic of a message's key, and the sender that the key names, or an empty text."""
    topic, _, sender = key[len(DATA) :].partition(SAID_BY)
    return topic, sender
