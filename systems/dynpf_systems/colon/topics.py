"""Topics of COLON, in addition to those common to all robots."""

from dynpf_protocol.topics import Topic

from dynpf_systems.colon.messages import CapsuleEstimate, CapsuleReading, CapsuleState

__all__ = ["TOPICS"]

TOPICS = (
    Topic(
        name="truth/capsule",
        type=CapsuleState,
        publishers=("simulator",),
        description="True pose of the capsule in pixels of its map, and the name of the map that holds",
    ),
    Topic(
        name="sensors/capsule",
        type=CapsuleReading,
        publishers=("sensors",),
        description="The capsule's last commanded motion, and its five ranges",
    ),
    Topic(
        name="estimator/capsule",
        type=CapsuleEstimate,
        publishers=("estimator",),
        wakes=False,
        description="Estimate of the capsule's pose in pixels, posterior over maps, and what has changed in them",
    ),
)
