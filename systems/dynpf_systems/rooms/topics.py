"""Topics of rooms, beside those that any robot may have."""

from dynpf_protocol.topics import Topic

from dynpf_systems.rooms.messages import Obstacles

__all__ = ["TOPICS"]

TOPICS = (
    Topic(
        name="truth/obstacles",
        type=Obstacles,
        publishers=("simulator",),
        wakes=False,
        description="People about and doors that are closed, in a room that has any",
    ),
)
