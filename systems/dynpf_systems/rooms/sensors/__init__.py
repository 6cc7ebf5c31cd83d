"""The sensors of robots in rooms: a module for each, and their list in the order in which a step reads them."""

from dynpf_systems.rooms.sensors.initial_pose import INITIAL_POSE
from dynpf_systems.rooms.sensors.landmarks import LANDMARKS
from dynpf_systems.rooms.sensors.lines import LINES
from dynpf_systems.rooms.sensors.odometry import ODOMETRY, ODOMETRY_POSE
from dynpf_systems.rooms.sensors.position import POSITION
from dynpf_systems.rooms.sensors.scan import SCAN, SCANNER

__all__ = ["SENSORS"]

SENSORS = (INITIAL_POSE, ODOMETRY, ODOMETRY_POSE, LANDMARKS, SCANNER, SCAN, LINES, POSITION)
