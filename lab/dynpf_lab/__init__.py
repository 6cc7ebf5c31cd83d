"""The laboratory: studies, measures, references, benchmarks, the command line, and what own nodes are made of.

``from dynpf_lab import Message, Node, Sensor`` is all that a module beside a scenario needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynpf_protocol.messages import Message
    from dynpf_protocol.topics import Topic
    from dynpf_runtime.every import Every
    from dynpf_services.nodes import Moment, Node, Sensor

    from dynpf.rng import Draws

__all__ = ["Draws", "Every", "Message", "Moment", "Node", "Sensor", "Topic"]

_HOMES = {
    "Draws": "dynpf.rng",
    "Every": "dynpf_runtime.every",
    "Message": "dynpf_protocol.messages",
    "Moment": "dynpf_services.nodes",
    "Node": "dynpf_services.nodes",
    "Sensor": "dynpf_services.nodes",
    "Topic": "dynpf_protocol.topics",
}


def __getattr__(name: str) -> Any:
    """Load what is asked for when it is: the command line is to start at once."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
