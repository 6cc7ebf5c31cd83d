"""Keys of messages, tokens and queries on the bus."""

__all__ = ["ALIVE", "BEAT", "CONTROL", "DATA", "JOURNAL", "READY", "RECORDER", "ROUTER", "SCENARIO", "TICK"]

DATA = "dynpf/data/"  # + topic
JOURNAL = "dynpf/journal/"  # + node
TICK = "dynpf/tick/"  # + node
BEAT = "dynpf/beat/"  # + process
CONTROL = "dynpf/control/"  # + stop, recorded
ALIVE = "dynpf/alive/"  # + process/boot, a liveliness token
READY = "dynpf/ready/"  # + process/boot, a liveliness token
SCENARIO = "dynpf/scenario"

ROUTER = "router"
RECORDER = "recorder"
