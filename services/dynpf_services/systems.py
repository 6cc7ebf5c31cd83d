"""What the systems of nodes bring to scenarios: kinds of nodes by section and name, and tables that nodes share."""

FACTS = {
    "task": "dynpf_services.kinds.parts:TASK",
    "map": "dynpf_services.kinds.rooms:MAP",
    "landmarks": "dynpf_services.kinds.rooms:LANDMARKS",
    "colon": "dynpf_services.kinds.colon:COLON",
    "maps": "dynpf_services.kinds.colon:DRAWINGS",
}

KINDS = {
    ("simulator", "workspace"): "dynpf_services.kinds.parts:WORKSPACE",
    ("simulator", "room"): "dynpf_services.kinds.rooms:ROOM",
    ("simulator", "capsule"): "dynpf_services.kinds.colon:CAPSULE",
    ("vision", ""): "dynpf_services.kinds.parts:VISION",
    ("sensors", "simulated"): "dynpf_services.kinds.rooms:SIMULATED",
    ("sensors", "log"): "dynpf_services.kinds.rooms:LOG",
    ("sensors", "capsule"): "dynpf_services.kinds.colon:RANGES",
    ("estimator", "rearrangement"): "dynpf_services.kinds.parts:ESTIMATOR",
    ("estimator", "localization"): "dynpf_services.kinds.rooms:LOCALIZATION",
    ("estimator", "capsule"): "dynpf_services.kinds.colon:ESTIMATOR",
    ("controller", "rearrangement"): "dynpf_services.kinds.parts:CONTROLLER",
    ("controller", "waypoints"): "dynpf_services.kinds.rooms:WAYPOINTS",
}
