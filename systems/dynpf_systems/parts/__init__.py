"""PARTS: a robot brings parts to their goals under an overhead camera; all that it brings by import string."""

FACTS = {"task": "dynpf_systems.parts.nodes:TASK"}

TOPICS = "dynpf_systems.parts.topics:TOPICS"

MEASURES = "dynpf_systems.parts.measures:MEASURES"

PICTURES = "dynpf_systems.parts.pictures:PICTURES"

STUDIES = {
    "parts-3": "dynpf_systems.parts.studies.tasks:THREE",
    "parts-6": "dynpf_systems.parts.studies.tasks:SIX",
    "parts-bounds": "dynpf_systems.parts.studies.bounds:STUDY",
    "parts-time": "dynpf_systems.parts.studies.times:STUDY",
    "parts-vision": "dynpf_systems.parts.studies.vision:STUDY",
    "parts-layouts": "dynpf_systems.parts.studies.layouts:STUDY",
    "parts-alike": "dynpf_systems.parts.studies.alike:STUDY",
}

KINDS = {
    ("simulator", "workspace"): "dynpf_systems.parts.nodes:WORKSPACE",
    ("vision", ""): "dynpf_systems.parts.nodes:VISION",
    ("estimator", "rearrangement"): "dynpf_systems.parts.nodes:ESTIMATOR",
    ("controller", "rearrangement"): "dynpf_systems.parts.nodes:CONTROLLER",
}

SENSORS = "dynpf_systems.parts.sensors:SENSORS"
