"""Topics of PARTS, in addition to those common to all robots."""

from dynpf_protocol.messages import CompressedImage
from dynpf_protocol.topics import Delivery, Topic

from dynpf_systems.parts.messages import Detections, Gripper, Identities, PartsCommand, PartsEstimate, PartsState

__all__ = ["TOPICS"]

TOPICS = (
    Topic(
        name="camera/image",
        type=CompressedImage,
        publishers=("simulator",),
        delivery=Delivery.FRESH,
        description="Frame of the overhead camera",
    ),
    Topic(
        name="truth/parts",
        type=PartsState,
        publishers=("simulator",),
        wakes=False,
        description="True positions of the parts, what is held, contacts so far",
    ),
    Topic(
        name="vision/detections",
        type=Detections,
        publishers=("vision",),
        description="Discs that the camera chain found, in workspace coordinates",
    ),
    Topic(
        name="sensors/overhead",
        type=Detections,
        publishers=("sensors",),
        description="Discs as a noisy overhead tracker gives them, for runs without camera frames",
    ),
    Topic(
        name="sensors/gripper",
        type=Gripper,
        publishers=("sensors",),
        wakes=False,
        description="Gripper contact switch and angle encoder",
    ),
    Topic(
        name="estimator/parts",
        type=PartsEstimate,
        publishers=("estimator",),
        wakes=False,
        description="Estimate of the parts, and which is held; sent before that of the robot, with the same stamp",
    ),
    Topic(
        name="estimator/identities",
        type=Identities,
        publishers=("estimator",),
        wakes=False,
        description="How sure it is which disc is which, where some look alike; sent before the robot's estimate",
    ),
    Topic(
        name="controller/parts",
        type=PartsCommand,
        publishers=("controller",),
        wakes=False,
        description="What the gripper shall do, and about which part; sent with the robot's velocity",
    ),
)
