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
    "SCENARIO",
    "STOP",
    "TICK",
]

DATA = "dynpf/data/"  # + topic
JOURNAL = "dynpf/journal/"  # + node
TICK = "dynpf/tick/"  # + node
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
