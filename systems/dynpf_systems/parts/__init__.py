"""PARTS: a robot brings parts to their goals under a camera; kinds of nodes, tables and sensors by import string."""

FACTS = {"task": "dynpf_systems.parts.nodes:TASK"}

KINDS = {
    ("simulator", "workspace"): "dynpf_systems.parts.nodes:WORKSPACE",
    ("vision", ""): "dynpf_systems.parts.nodes:VISION",
    ("estimator", "rearrangement"): "dynpf_systems.parts.nodes:ESTIMATOR",
    ("controller", "rearrangement"): "dynpf_systems.parts.nodes:CONTROLLER",
}

SENSORS = "dynpf_systems.parts.sensors:SENSORS"
