"""The check for ways from data to code finds each kind, however it is spelt, and lets what is safe pass."""

import pytest

from checks.data_code import findings

PICKLES = [
    "import pickle",
    "import pickle as p",
    "from pickle import loads as text",
    "from _pickle import Unpickler",
    "import marshal",
    "import shelve",
    "import dill",
    "import cloudpickle",
    "import joblib\njoblib.load('rows')",
    "from joblib import load",
    "from joblib.numpy_pickle import load_temporary_memmap",
    "import joblib as j\nread = j.load",
    "import numpy as np\nnp.load('x', allow_pickle=True)",
    "import numpy as np\nnp.load('x', None, True)",
    "import numpy as np\nnp.load('x', **settings)",
    "from numpy import load\nload('x', allow_pickle=trusted)",
    "read(path, allow_pickle=True)",
]
COMPILES = [
    "eval('1')",
    "exec(text)",
    "compile(text, 'x', 'eval')",
    "run = eval",
    "import builtins\nbuiltins.eval('1')",
    "from builtins import exec as run",
    "import runpy",
    "import code",
    "import types\ntypes.FunctionType(c, {})",
]
OBJECTS = [
    "import yaml\nyaml.load(text, yaml.SafeLoader)",
    "import yaml\nyaml.unsafe_load(text)",
    "import yaml as y\ny.full_load(text)",
    "from yaml import FullLoader",
    "from yaml import *",
    "import yaml\ngetattr(yaml, 'load')(text)",
]
IMPORTS = [
    "__import__(name)",
    "import importlib\nimportlib.import_module(name)",
    "import importlib as i\ni.import_module(f'services.{name}')",
    "from importlib import import_module\nimport_module(name)",
    "from importlib import import_module\nmake = import_module",
    "import importlib.util\nimportlib.util.find_spec(name)",
    "from importlib.util import spec_from_file_location as s\ns('x', path)",
    "import importlib\nhanded(importlib)",
    "import pkgutil\npkgutil.resolve_name(name)",
    "import pydoc",
]


@pytest.mark.parametrize("source", [*PICKLES, *COMPILES, *OBJECTS, *IMPORTS])
def test_finds_each_way_from_data_to_code_also_inside_functions(source: str) -> None:
    nested = "def read():\n" + "\n".join(f"    {line}" for line in source.splitlines())
    last = len(source.splitlines())
    for file in ("services/rows.py", "dynpf/anything.py", "tests/unit/test_anything.py"):
        assert any(line.startswith(f"{file}:{last}:") for line in findings(source, file))
        assert any(line.startswith(f"{file}:{last + 1}:") for line in findings(nested, file))


def test_lets_what_is_safe_pass() -> None:
    source = """
import importlib
import re
from importlib import import_module
from importlib.metadata import version

import numpy as np
import yaml
from joblib import Parallel, delayed

def read(path, model):
    import_module("services.rows")
    importlib.import_module("services.rows")
    importlib.invalidate_caches()
    model.eval()
    np.load(path), np.load(path, allow_pickle=False)
    return re.compile("x"), yaml.safe_load(path), Parallel(2)(delayed(model)() for _ in path)
"""
    assert findings(source, "services/rows.py") == []


def test_only_the_place_of_the_users_code_imports_what_a_text_names() -> None:
    source = "import importlib\nimportlib.import_module(name)"
    assert findings(source, "services/dynpf_services/scenario/user_code.py") == []
    assert findings(source, "services/dynpf_services/scenario/recorded.py") != []
    assert findings("import pickle", "services/dynpf_services/scenario/user_code.py") != []
