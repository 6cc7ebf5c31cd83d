"""Finds ways from data to code: `python -m checks.data_code` prints each finding and exits 1 if there is one.

What dynpf reads may be a stranger's: recordings, snapshots, rows, maps, scenarios, messages. Nothing that runs what is
in a file may be used on any of it, so nowhere at all: neither pickles and their kin, nor source that is compiled, nor
YAML that makes objects, nor a module that a text names. One place may import what a text names, and asks first.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

from checks.pure_code import bindings, dotted, imported, within

__all__ = ["findings"]

PACKAGES = (
    "benchmarks",
    "checks",
    "docs",
    "dynpf",
    "experiments",
    "formats",
    "lab",
    "protocol",
    "runtime",
    "services",
    "systems",
    "tests",
)

_UNPICKLES = "runs what is in the data"
_COMPILES = "makes code of a text"
_OBJECTS = "makes any object that the data names: take yaml.safe_load"
_IMPORTS = "imports what a text names"

FORBIDDEN = {
    **dict.fromkeys(("pickle", "_pickle", "pickletools", "shelve", "marshal"), _UNPICKLES),
    **dict.fromkeys(("dill", "cloudpickle", "jsonpickle", "joblib.load", "joblib.numpy_pickle"), _UNPICKLES),
    **dict.fromkeys(("joblib.externals", "joblib.Memory", "joblib.memory", "numba.core.serialize"), _UNPICKLES),
    **dict.fromkeys(("multiprocessing.connection", "pandas.read_pickle", "torch.load"), _UNPICKLES),
    **dict.fromkeys(("code", "codeop", "runpy", "types.CodeType", "types.FunctionType"), _COMPILES),
    **dict.fromkeys(("timeit.timeit", "timeit.Timer", "logging.config"), _COMPILES),
    **dict.fromkeys(("builtins.eval", "builtins.exec", "builtins.compile"), _COMPILES),
    **dict.fromkeys(("yaml.load", "yaml.load_all", "yaml.full_load", "yaml.full_load_all"), _OBJECTS),
    **dict.fromkeys(("yaml.unsafe_load", "yaml.unsafe_load_all", "yaml.Loader", "yaml.CLoader"), _OBJECTS),
    **dict.fromkeys(("yaml.UnsafeLoader", "yaml.CUnsafeLoader", "yaml.FullLoader", "yaml.CFullLoader"), _OBJECTS),
    **dict.fromkeys(
        ("importlib.import_module", "importlib.util", "importlib.machinery", "importlib.__import__"), _IMPORTS
    ),
    **dict.fromkeys(("builtins.__import__", "pkgutil", "pydoc", "zipimport", "imp"), _IMPORTS),
    **dict.fromkeys(("unittest.mock.patch",), _IMPORTS),
}
BUILTINS = {**dict.fromkeys(("eval", "exec", "compile"), _COMPILES), "__import__": _IMPORTS}

EXCEPTIONS = {
    # The one place that imports what a scenario names: its author's own, or what the reader of a recording has allowed.
    ("services/dynpf_services/scenario/user_code.py", "importlib.import_module"),
    ("services/dynpf_services/scenario/user_code.py", "importlib.util.find_spec"),
    # These take the module from a table of their own.
    ("lab/dynpf_lab/__init__.py", "importlib.import_module"),
    ("formats/dynpf_formats/shipped.py", "importlib.import_module"),
    ("formats/dynpf_formats/recording/provenance.py", "importlib.util.find_spec"),
    ("dynpf/__init__.py", "importlib.import_module"),
    ("dynpf/kernels/__init__.py", "importlib.import_module"),
    ("lab/dynpf_lab/cli/main.py", "importlib.import_module"),
    # The examples of our own documents.
    ("tests/unit/docs/test_readme.py", "exec"),
    ("tests/unit/docs/test_viewing.py", "exec"),
    ("tests/unit/docs/test_viewing.py", "compile"),
    ("tests/unit/recording/test_recording_digest.py", "exec"),
    ("tests/unit/recording/test_recording_digest.py", "compile"),
}
_WHOLE = {"builtins", "importlib", "joblib", "yaml"}
_LOADS_ARRAYS = "numpy.load"
_BEFORE_PICKLES = 2  # of its arguments by place


def findings(source: str, file: str) -> list[str]:
    """Return one line for each way from data to code in a file's source; ``file`` is relative to the repository."""
    tree = ast.parse(source, file)
    bound = bindings(tree)
    found = {*_imports(tree), *_uses(tree, bound), *_arrays(tree, bound)}
    return [f"{file}:{line}: {name} {why}" for line, name, why in sorted(found) if (file, name) not in EXCEPTIONS]


def _imports(tree: ast.AST) -> Iterator[tuple[int, str, str]]:
    for line, name in imported(tree):
        if name.endswith(".*") and any(one.startswith(name[:-1]) for one in FORBIDDEN):
            yield line, name, "hides what is taken"
        # What is taken from importlib is judged where it is used: of a literal name, import_module is an import.
        elif not within(name, "importlib") and (why := _objection(name)):
            yield line, name, why


def _uses(tree: ast.AST, bound: dict[str, str]) -> Iterator[tuple[int, str, str]]:
    inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    literal = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call) and _names_a_literal(node)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute | ast.Name) or not isinstance(node.ctx, ast.Load) or id(node) in inner:
            continue
        root, *rest = dotted(node)
        if root in bound:
            name = ".".join((bound[root], *rest))
            if (why := _objection(name)) and not (why == _IMPORTS and id(node) in literal):
                yield node.lineno, name, why
            elif name in _WHOLE:
                yield node.lineno, name, "is a module, and may not be handed about"
        elif root in BUILTINS and not rest and id(node) not in literal:
            yield node.lineno, root, BUILTINS[root]


def _names_a_literal(call: ast.Call) -> bool:
    imports = dotted(call.func)[-1] in {"import_module", "__import__", "find_spec"}
    return imports and bool(call.args) and isinstance(call.args[0], ast.Constant)


def _arrays(tree: ast.AST, bound: dict[str, str]) -> Iterator[tuple[int, str, str]]:
    """NumPy reads objects, by unpickling them, only if it is told to."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        for keyword in node.keywords:
            if keyword.arg == "allow_pickle" and not (
                isinstance(keyword.value, ast.Constant) and keyword.value.value is False
            ):
                yield node.lineno, "allow_pickle", _UNPICKLES
        root, *rest = dotted(node.func)
        if ".".join((bound.get(root, root), *rest)) == _LOADS_ARRAYS and (
            len(node.args) > _BEFORE_PICKLES or any(keyword.arg is None for keyword in node.keywords)
        ):
            yield node.lineno, _LOADS_ARRAYS, _UNPICKLES


def _objection(name: str) -> str | None:
    return next((why for start, why in FORBIDDEN.items() if within(name, start)), None)


def main() -> int:
    root = Path(__file__).parents[1]
    paths = sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))
    found = [line for path in paths for line in findings(path.read_text(), path.relative_to(root).as_posix())]
    print(
        "\n".join(found) or f"Code from data: {len(paths)} files, no way found.",
        file=sys.stderr if found else sys.stdout,
    )
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
