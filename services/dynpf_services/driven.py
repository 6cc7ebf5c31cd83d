"""A simulated robot that a person drives for a moment, instead of its controller."""

from typing import NamedTuple, Self

from dynpf_protocol.messages import Drive, Move

__all__ = ["Driven"]


class Driven(NamedTuple):
    """Velocity (m/s; ``vx`` alone is forward for a robot that drives), turning rate (rad/s), and until when, ns."""

    vx: float
    vy: float
    w: float
    until_ns: int

    @classmethod
    def by(cls, act: Drive | Move, stamp_ns: int) -> Self:
        """Return what an act that enters at a time makes of the robot."""
        until_ns = stamp_ns + round(act.lasts_s * 1e9)
        return cls(act.v, 0.0, act.w, until_ns) if isinstance(act, Drive) else cls(act.vx, act.vy, act.w, until_ns)

    def is_over(self, stamp_ns: int) -> bool:
        """Return whether it no longer holds."""
        return stamp_ns >= self.until_ns
