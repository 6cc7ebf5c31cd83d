"""The check of portable code finds each kind of arithmetic whose bits depend on the machine, and lets the rest pass."""

from pathlib import Path

import pytest

from checks import portable_code
from checks.portable_code import findings
from checks.portable_names import CASTS, EXACT

NAMES = [
    "import numpy as np\nnp.sin(x)",
    "import numpy as np\nnp.linalg.solve(a, b)",
    "import numpy as np\nnp.einsum('ij->i', a)",
    "from numpy import exp as e\ne(x)",
    "from numpy import linalg\nlinalg.norm(x)",
    "import numpy as np\nfunction = np.log",
    "import math\nmath.hypot(x, y)",
    "from math import atan2\natan2(y, x)",
    "import cv2\ncv2.magnitude(x, y)",
    "from statistics import NormalDist\nNormalDist()",
    "import numpy as np\n_log = np.log\n_log(x)",
]
OPERATORS = [
    "a @ b",
    "a @= b",
    "x ** 2",
    "x ** 3",
    "x ** 2.5",
    "x ** y",
    "x ** -1",
    "x **= 2",
    "1j * x",
    "complex(x, y)",
    "a.dot(b)",
]
CALLS = [
    "sum(values)",
    "sum(x * y for x, y in pairs)",
    "sum([0.1] * 3)",
    "sum(HALF * int(x) for x in values)",
    "sum(x > 0 and x for x in values)",
    "pow(x, y)",
    "import numpy as np\nnp.partition(x, 3)",
    "import numpy as np\nnp.partition(x, 3)[2]",
    "import numpy as np\nnp.argsort(x)",
    "x.argsort()",
    "x.argpartition(3)",
    "import numpy as np\nnp.arange(0.0, 1.0, 0.1)",
    "import numpy as np\nnp.arange(a / b)",
    "import numpy as np\nnp.arange(len(x) * 0.1)",
    "import numba\nnumba.njit(fastmath=True)",
    "import numba\nnumba.njit(parallel=True)",
]
CAST = [
    "x.astype(int)",
    "import numpy as np\nnp.floor(x).astype(np.int32)",
    "import numpy as np\nx.astype(np.uint8, casting='unsafe')",
    "import numpy as np\nnp.int32(x)",
    "import numpy as np\n_i = np.int64\n_i(x)",
    "x.astype('int32')",
    "x.astype(dtype=int)",
    "import numpy as np\nnp.asarray(x, dtype=np.int64)",
    "import numpy as np\nnp.ascontiguousarray(x, np.uint8)",
    "import numpy as np\nnp.int32(HALF * x)",
]
SETS = [
    "for name in {a, b}: pass",
    "list(set(names))",
    "names = set(x) | set(y)\nfor name in names: pass",
    "[name for name in frozenset(names)]",
    "tuple(first.union(second))",
    "(*{a, b}, c)",
]
APART = [
    "from dynpf.metrics.trajectory import trajectory_error",
    "from dynpf.reference.estimate import pose_moments",
    "import dynpf.filters.smoothing",
]


@pytest.mark.parametrize("source", [*NAMES, *OPERATORS, *CALLS, *CAST, *SETS, *APART])
def test_finds_what_depends_on_the_machine_also_inside_functions(source: str) -> None:
    nested = "def step():\n" + "\n".join(f"    {line}" for line in source.splitlines())
    last = len(source.splitlines())
    assert any(line.startswith(f"node.py:{last}:") for line in findings(source, "node.py"))
    assert any(line.startswith(f"node.py:{last + 1}:") for line in findings(nested, "node.py"))


KERNELS = ["import math\nmath.sqrt(x)", "import numpy as np\nnp.uint32(x)", "int(x)"]


@pytest.mark.parametrize("source", KERNELS)
def test_is_stricter_in_kernels(source: str) -> None:
    assert findings(source, "dynpf/kernels/some.py")


PORTABLE = [
    "import numpy as np\nnp.sqrt(np.sum(np.square(x), axis=0))",
    "import numpy as np\nnp.argsort(x, kind='stable')",
    "x * x * x",
    "2**level + 2.0**-53 + 10**6",
    "sum(len(part) for part in parts)",
    "sum(int(count) for count in counts)",
    "sum(each > 0 for each in values)",
    "sum(each > 0 and each is not None for each in values)",
    "import numpy as np\nnp.partition(x, n - 3)[n - 3]",
    "import math\nmath.fsum(values)",
    "import numpy as np\nx.astype(np.int32, casting='same_kind')",
    "import numpy as np\nx.astype(np.float32)",
    "import numpy as np\nnp.arange(n) * 0.1",
    "import math\nimport numpy as np\nnp.arange(math.ceil(a / 0.1)) * 0.1",
    "import numpy as np\nx.astype(np.uint8, casting='safe')",
    "import numpy as np\nnp.array([a, b], dtype=np.int64)",
    "import numpy as np\nnp.asarray(x, dtype=np.float32)",
    "import numpy as np\nnp.uint32(x >> 3)",
    "import numpy as np\nnp.uint8(FREE)",
    "import numpy as np\nnp.uint64(_ROW * LANES)",
    "import numpy as np\nnp.uint8(255)",
    "for name in sorted({a, b}): pass",
    "name in {a, b}",
    "'a/b'.partition('/')",
    "from dynpf.portable import sin\nsin(x)",
    "from dynpf.maps.landmarks import LandmarkMap",
]


@pytest.mark.parametrize("source", PORTABLE)
def test_lets_portable_code_pass(source: str) -> None:
    assert findings(source, "node.py") == []


def test_no_name_stands_in_the_list_for_two_reasons() -> None:
    names = [name for each in EXACT.values() for name in each]
    assert len(names) == len(set(names))


def test_no_place_of_a_cast_stands_in_the_list_for_two_reasons() -> None:
    places = [place for each in CASTS.values() for place in each]
    assert len(places) == len(set(places))


def test_in_every_function_of_the_list_something_is_cast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(portable_code, "_REVIEWED", set())
    root = Path(__file__).parents[2]
    places = {place for each in CASTS.values() for place in each}
    found = {file: "\n".join(findings((root / file).read_text(), file)) for file, _ in places}
    assert [(file, name) for file, name in sorted(places) if f" in {name}:" not in found[file]] == []
