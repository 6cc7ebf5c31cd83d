"""What an imported log of a laser scanner brings to a scenario that needs one."""

from dynpf_services.scenario.schema import LogFacts

YAML = b"image: house.pgm\nresolution: 0.5\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
IMAGE = b"P5\n2 1\n255\n\x00\xfe"
FACTS = LogFacts(
    digest="d1",
    landmarks=[{"id": 6, "x": 1.0, "y": 2.0}],
    starts={"": (1.0, 2.0, 0.5)},
    files={"house.yaml": YAML, "house.pgm": IMAGE},
)
