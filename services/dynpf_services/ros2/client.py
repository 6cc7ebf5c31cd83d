"""How dynpf joins a robot's Zenoh: as a client of its router, which passes nothing on between peers."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh
from dynpf_protocol.errors import UsageError

__all__ = ["LARGEST", "MOST_WAITING", "NoRouterError", "router_session"]

LARGEST = 32 * 2**20
"""Bytes of the largest message that is received."""

MOST_WAITING = 64 * 2**20
"""Bytes of all that has arrived and waits."""

_CLOSE_S = 1.0


class NoRouterError(UsageError):
    """Nothing answers where a router should be."""


@contextmanager
def router_session(endpoint: str) -> Iterator[zenoh.Session]:
    """Open a session with a robot's router; raises NoRouterError if nothing answers at ``endpoint``."""
    config = zenoh.Config()
    settings = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        "transport/link/rx/max_message_size": LARGEST,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
    }
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise NoRouterError(
            f"--connect {endpoint}: no Zenoh router of a robot: {str(error).partition(' at /')[0]}; on the robot, "
            "this starts it: ros2 run rmw_zenoh_cpp rmw_zenohd (or zenoh-bridge-ros2dds)"
        ) from error
    try:
        yield session
    finally:
        closing = threading.Thread(target=session.close, daemon=True)
        closing.start()
        closing.join(_CLOSE_S)
