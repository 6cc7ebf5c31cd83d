"""What an estimator says of inputs that never came: its estimate went on without them."""

from dynpf_protocol.messages import HostEvent, Log, LogLevel, timestamp
from dynpf_runtime.node import Output

__all__ = ["GAPS", "gap_warning"]

GAPS = "event/estimator"
"""Where the host tells of gaps in what the estimator consumes."""


def gap_warning(gap: HostEvent, stamp_ns: int) -> Output:
    """Return the warning, for the log, that messages of a topic are missing or late."""
    which = f"message {gap.first}" if gap.first == gap.last else f"messages {gap.first} to {gap.last}"
    text = f"{gap.topic} of {gap.node}: {which} did not come in time; the estimate goes on without"
    return Output("log", Log(timestamp=timestamp(stamp_ns), level=LogLevel.WARNING, message=text, name="estimator"))
