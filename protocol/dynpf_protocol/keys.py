"""Keys of messages, tokens and queries on the bus."""

__all__ = [
    "ALIVE",
    "BEAT",
    "CONTROL",
    "DATA",
    "JOURNAL",
    "OBSERVER",
    "OPERATOR",
    "READY",
    "RECORDED",
    "RECORDER",
    "ROUTER",
    "RUN",
    "SCENARIO",
    "STOP",
    "TICK",
]

RUN = "dynpf/run/"  # all that a recorder takes, by one subscription, which keeps the order of each sender's messages
DATA = "dynpf/run/data/"  # + topic
JOURNAL = "dynpf/run/journal/"  # + node
TICK = "dynpf/run/tick/"  # + node
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
OPERATOR = "operator"  # a person who may end the run
