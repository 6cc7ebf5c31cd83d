"""Robots in rooms, simulated or logged, located in a map; all that it brings by import string."""

FACTS = {"map": "dynpf_systems.rooms.nodes:MAP", "landmarks": "dynpf_systems.rooms.nodes:LANDMARKS"}

TOPICS = "dynpf_systems.rooms.topics:TOPICS"

MEASURES = "dynpf_systems.rooms.measures:MEASURES"

PICTURES = "dynpf_systems.rooms.pictures:PICTURES"

STUDIES = {
    "indoor": "dynpf_systems.rooms.studies.indoor:STUDY",
    "landmark": "dynpf_systems.rooms.studies.landmark:STUDY",
    "turtlebot": "dynpf_systems.rooms.studies.turtlebot:STUDY",
    "kidnap": "dynpf_systems.rooms.studies.kidnap:STUDY",
}

KINDS = {
    ("simulator", "room"): "dynpf_systems.rooms.nodes:ROOM",
    ("estimator", "localization"): "dynpf_systems.rooms.nodes:LOCALIZATION",
    ("controller", "waypoints"): "dynpf_systems.rooms.nodes:WAYPOINTS",
}

SENSORS = "dynpf_systems.rooms.sensors:SENSORS"
