"""The types of ROS 2 as those of DDS have the same bytes."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="this processor has no wheels of Cyclone DDS")

from dynpf_formats.importers.bag_plan import TRANSFORMS, TYPES
from dynpf_formats.ros2.answers import ANSWERS
from dynpf_formats.ros2.robot import CLOCK, IMU, INITIAL_POSE
from dynpf_formats.ros2.types import RosTypes
from dynpf_services.ros2.dds import DdsTypes
from rosbags.interfaces import Nodetype

ROS = RosTypes()
DDS = DdsTypes(ROS)
USED = sorted({CLOCK, IMU, INITIAL_POSE, *TYPES, *(kind.type for kind in ANSWERS)} - {TRANSFORMS[1]})
SCALARS = {"string": "map", "bool": True, "float32": 0.5, "float64": -2.25}


def filled(node, inner):
    """Return a value for a field: something in every part, three in every sequence."""
    if node == Nodetype.NAME:
        return ROS.make(inner, *(filled(*parts) for _, parts in ROS.fields(inner)))
    if node == Nodetype.BASE:
        return SCALARS.get(inner[0], 7)
    (element, detail), size = inner
    values = [filled(element, detail) for _ in range(size if node == Nodetype.ARRAY else 3)]
    return values if element == Nodetype.NAME or detail[0] == "string" else np.array(values, detail[0])


@pytest.mark.parametrize("kind", USED)
def test_a_message_is_the_same_bytes_by_dds(kind):
    data = ROS.encode(kind, filled(Nodetype.NAME, kind))
    message = DDS[kind].deserialize(data)
    again = message.serialize(use_version_2=False)
    assert ROS.encode(kind, ROS.decode(kind, again)) == data
    assert len(again) == len(data)
