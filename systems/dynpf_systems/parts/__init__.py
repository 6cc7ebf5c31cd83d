"""PARTS: a robot brings parts to their goals under an overhead camera; all that it brings by import string."""

FACTS = {"task": "dynpf_systems.parts.nodes:TASK"}

TOPICS = "dynpf_systems.parts.topics:TOPICS"

KINDS = {
    ("simulator", "workspace"): "dynpf_systems.parts.nodes:WORKSPACE",
    ("vision", ""): "dynpf_systems.parts.nodes:VISION",
    ("estimator", "rearrangement"): "dynpf_systems.parts.nodes:ESTIMATOR",
    ("controller", "rearrangement"): "dynpf_systems.parts.nodes:CONTROLLER",
}
