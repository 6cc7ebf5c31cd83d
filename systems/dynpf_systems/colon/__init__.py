"""COLON: a capsule in a tube whose walls change; all that it brings by import string."""

FACTS = {"colon": "dynpf_systems.colon.nodes:COLON", "maps": "dynpf_systems.colon.nodes:DRAWINGS"}

TOPICS = "dynpf_systems.colon.topics:TOPICS"

MEASURES = "dynpf_systems.colon.measures:MEASURES"

PICTURES = "dynpf_systems.colon.pictures:PICTURES"

STUDIES = {
    "colon-particles": "dynpf_systems.colon.studies.experiments:PARTICLES",
    "colon-cases": "dynpf_systems.colon.studies.experiments:CASES_STUDY",
    "colon-growth": "dynpf_systems.colon.studies.experiments:GROWTH",
    "colon-hypotheses": "dynpf_systems.colon.studies.experiments:HYPOTHESES",
}

KINDS = {
    ("simulator", "capsule"): "dynpf_systems.colon.nodes:CAPSULE",
    ("sensors", "capsule"): "dynpf_systems.colon.nodes:RANGES",
    ("estimator", "capsule"): "dynpf_systems.colon.nodes:ESTIMATOR",
}
