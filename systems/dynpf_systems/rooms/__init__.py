"""Robots in rooms, simulated or logged, located in a map; kinds of nodes, tables and sensors by import string."""

FACTS = {"map": "dynpf_systems.rooms.nodes:MAP", "landmarks": "dynpf_systems.rooms.nodes:LANDMARKS"}

KINDS = {
    ("simulator", "room"): "dynpf_systems.rooms.nodes:ROOM",
    ("estimator", "localization"): "dynpf_systems.rooms.nodes:LOCALIZATION",
    ("controller", "waypoints"): "dynpf_systems.rooms.nodes:WAYPOINTS",
}

SENSORS = "dynpf_systems.rooms.sensors:SENSORS"
