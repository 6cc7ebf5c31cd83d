"""The laboratory: runs in Python, references, benchmarks, the command line, and the basis of nodes of your own.

``from dynpf_lab import run, read`` is for notebooks; ``from dynpf_lab import Message, Node, Sensor`` is what a module
of a user's scenario needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynpf_experiments.sweep import sweep
    from dynpf_protocol.messages import Message
    from dynpf_protocol.topics import Topic
    from dynpf_runtime.every import Every
    from dynpf_services.nodes import Moment, Node, Sensor

    from dynpf.rng import Draws
    from dynpf_lab.notebook import Run, read, run

__all__ = ["Draws", "Every", "Message", "Moment", "Node", "Run", "Sensor", "Topic", "read", "run", "sweep"]

_HOMES = {
    "Draws": "dynpf.rng",
    "Every": "dynpf_runtime.every",
    "Message": "dynpf_protocol.messages",
    "Moment": "dynpf_services.nodes",
    "Node": "dynpf_services.nodes",
    "Run": "dynpf_lab.notebook",
    "Sensor": "dynpf_services.nodes",
    "Topic": "dynpf_protocol.topics",
    "read": "dynpf_lab.notebook",
    "run": "dynpf_lab.notebook",
    "sweep": "dynpf_experiments.sweep",
}


def __getattr__(name: str) -> Any:
    """Load names at their first use, so that the command line starts quickly."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
