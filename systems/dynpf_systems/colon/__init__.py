"""COLON: a capsule in a tube whose walls change; all that it brings by import string."""

FACTS = {"colon": "dynpf_systems.colon.nodes:COLON", "maps": "dynpf_systems.colon.nodes:DRAWINGS"}

TOPICS = "dynpf_systems.colon.topics:TOPICS"

KINDS = {
    ("simulator", "capsule"): "dynpf_systems.colon.nodes:CAPSULE",
    ("sensors", "capsule"): "dynpf_systems.colon.nodes:RANGES",
    ("estimator", "capsule"): "dynpf_systems.colon.nodes:ESTIMATOR",
}
