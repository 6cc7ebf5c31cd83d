"""The check of pure code finds each kind of impurity, however it is spelt, and lets pure code pass."""

import pytest

from checks.pure_code import findings

CLOCK = ["import time", "from time import time as t", "import datetime as d", "import cv2\ncv2.getTickCount()"]
RANDOMNESS = [
    "import random",
    "from secrets import token_bytes",
    "import uuid",
    "import numpy as np\nnp.random.rand(3)",
    "import numpy as np\nnp.random.default_rng(3).normal()",
    "import numpy as np\ndraw = np.random.normal",
    "import numpy.random as r\nr.normal()",
    "from numpy import random as r\nr.normal()",
    "from numpy.random import default_rng as g",
    "import numpy as np\nnp.random.Generator(np.random.Philox(3))",
    "import numpy as np\nr = np.random",
    "import numpy as np\ngetattr(np, 'random').rand()",
    "import cv2\ncv2.randn(x, 0, 1)",
    "key = hash('name')",
]
SURROUNDINGS = [
    "import os",
    "from os import environ as e",
    "import sys",
    "open('x')",
    "read = open",
    "from pathlib import Path",
    "import socket",
    "from subprocess import run",
    "import numpy as np\nnp.load('x')",
    "from numpy import fromfile",
    "import cv2 as c\nc.imread('x')",
    "print(1)",
    "eval('1')",
    "__import__('time')",
    "import zenoh",
    "from mcap.reader import make_reader",
    "import dynpf_runtime.node\ndynpf_runtime.bus.host.run_node()",
    "from services import recorder",
    "from ..recorder import write",
    "from dynpf_systems.parts.measures import Course",
    "from dynpf_systems.rooms.studies import ways",
    "from .studies.runs import run_parts",
]
THREADS = [
    "import threading",
    "from concurrent.futures import ThreadPoolExecutor",
    "import asyncio",
    "import cv2\ncv2.setNumThreads(4)",
]


@pytest.mark.parametrize("source", [*CLOCK, *RANDOMNESS, *SURROUNDINGS, *THREADS])
def test_finds_impurity_also_inside_functions(source: str) -> None:
    nested = "def step():\n" + "\n".join(f"    {line}" for line in source.splitlines())
    last = len(source.splitlines())
    assert any(line.startswith(f"node.py:{last}:") for line in findings(source, "node.py"))
    assert any(line.startswith(f"node.py:{last + 1}:") for line in findings(nested, "node.py"))


def test_lets_pure_code_pass() -> None:
    source = """
import numpy as np
import numpy.random as r
import dynpf_runtime.node
from collections.abc import Mapping
from dynpf.rng import generator
from dynpf_protocol.landmarks import Landmark
from .config import Params

class Reading:
    id: int
    open: bool

def step(node: dynpf_runtime.node.Node, rng: np.random.Generator, other: r.Generator) -> np.ndarray:
    return np.linalg.norm(rng.normal(size=3)) + node.id + node.time.time() + generator(1, "a", 2).random()
"""
    assert findings(source, "services/estimator/node.py") == []


def test_only_the_module_of_random_streams_makes_bit_generators() -> None:
    source = "import numpy as np\nnp.random.Philox(key=3)"
    assert findings(source, "dynpf/rng.py") == []
    assert findings(source, "dynpf/other.py") != []
    assert findings("import numpy as np\nnp.random.PCG64(3)", "dynpf/rng.py") != []
