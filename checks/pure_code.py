"""Finds what pure code must not do: `python -m checks.pure_code` prints each finding and exits 1 if there is one.

Replay gives the same bytes only if a step depends on nothing but its inputs, and a run can be simulated only if what
its processes do depends on nothing but events. So the algorithms, the messages, the nodes and the runtime's machines
read no clock, draw no unkeyed random number, look at no environment, do no input or output and start no thread.
They import only what is listed here; of that, some names stay forbidden. Names are followed through imports, renamed
or not; a module may not be handed about as a value, since what is taken from it then could not be seen.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["PURE", "bindings", "dotted", "findings", "imported", "is_experiment", "within"]

PURE = (
    "dynpf",
    "protocol/dynpf_protocol",
    "runtime/dynpf_runtime/every.py",
    "runtime/dynpf_runtime/faults.py",
    "runtime/dynpf_runtime/gaps.py",
    "runtime/dynpf_runtime/graph.py",
    "runtime/dynpf_runtime/inbox.py",
    "runtime/dynpf_runtime/machines",
    "runtime/dynpf_runtime/node.py",
    "runtime/dynpf_runtime/sequence_numbers.py",
    "runtime/dynpf_runtime/snapshot.py",
    "runtime/dynpf_runtime/source.py",
    "services/dynpf_services/driven.py",
    "services/dynpf_services/estimates.py",
    "services/dynpf_services/nodes.py",
    "services/dynpf_services/sensors",
    "systems/dynpf_systems",
)

_BESIDE = ("amcl", "fit", "measures", "pictures", "studies", "verdict")
"""What a system makes scenarios of, measures of its runs, draws of them and studies by them; no node reaches it."""
_EXPERIMENT = re.compile(rf"(systems[/.])?dynpf_systems[/.]\w+[/.]({'|'.join(_BESIDE)})\b")
_MEASURES = "measures runs, and is no part of one"

MODULES = (
    *(re.sub(r"^\w+/(?=dynpf_)", "", root).removesuffix(".py").replace("/", ".") for root in PURE),
    *("__future__", "abc", "base64", "bisect", "collections", "copy", "dataclasses", "enum", "functools", "hashlib"),
    *(
        "heapq",
        "itertools",
        "json",
        "math",
        "numbers",
        "operator",
        "re",
        "statistics",
        "string",
        "struct",
        "types",
        "typing",
    ),
    *("cv2", "msgspec", "numba", "numpy", "yaml"),
    # What the machines of a run know besides: the executor of a node, the plan, and how a recording ended.
    *("dynpf_runtime.executor", "dynpf_runtime.plan", "dynpf_formats.recording.header"),
    # What a node is built of: its scenario, from which everything has been read that there is to read.
    *(f"dynpf_services.scenario.{name}" for name in ("context", "kinds", "schema", "user_component")),
)

BUILTINS = {
    **dict.fromkeys(("open", "print", "input", "breakpoint"), "does input or output"),
    **dict.fromkeys(("eval", "exec", "compile", "__import__"), "can reach anything"),
    **dict.fromkeys(("hash", "id"), "differs between processes"),
}

# Beneath an allowed module. "numpy.random" stands for all in it but the type that generators have.
FORBIDDEN = {
    **dict.fromkeys(("numpy.random", "cv2.setRNGSeed"), "is not keyed: take a generator made by dynpf.rng"),
    **dict.fromkeys(("cv2.randn", "cv2.randu", "cv2.randShuffle"), "is not keyed: take a generator made by dynpf.rng"),
    **dict.fromkeys(("statistics.NormalDist.samples",), "is not keyed: take a generator made by dynpf.rng"),
    **dict.fromkeys(("cv2.getTickCount", "cv2.getCPUTickCount", "cv2.TickMeter"), "reads a clock"),
    **dict.fromkeys(("cv2.setNumThreads", "cv2.setUseOptimized"), "belongs to the host"),
    **dict.fromkeys(("cv2.imread", "cv2.imreadmulti", "cv2.imwrite", "cv2.imwritemulti"), "does input or output"),
    **dict.fromkeys(("cv2.VideoCapture", "cv2.VideoWriter", "cv2.FileStorage"), "does input or output"),
    **dict.fromkeys(("cv2.imshow", "cv2.waitKey", "cv2.namedWindow"), "does input or output"),
    **dict.fromkeys(("numpy.load", "numpy.loadtxt", "numpy.genfromtxt", "numpy.fromfile"), "does input or output"),
    **dict.fromkeys(("numpy.save", "numpy.savez", "numpy.savez_compressed", "numpy.savetxt"), "does input or output"),
    **dict.fromkeys(("numpy.memmap", "numpy.ctypeslib"), "does input or output"),
}
ALLOWED = ("numpy.random.Generator",)

EXCEPTIONS = {
    ("dynpf/rng.py", "numpy.random.Philox"),
    ("dynpf/__init__.py", "importlib.import_module"),
    ("dynpf/kernels/__init__.py", "importlib.import_module"),
    # Threads that change no bit of the result, in the number that the caller gives.
    ("dynpf/filters/models.py", "concurrent.futures.ThreadPoolExecutor"),
    # Snapshots are compared with nothing: what the compressor makes of them may change with its version.
    *(
        ("protocol/dynpf_protocol/snapshots.py", f"zstandard{name}")
        for name in ("", ".ZstdCompressor", ".ZstdDecompressor", ".ZstdError", ".get_frame_parameters")
    ),
    # Read by type checkers alone.
    ("dynpf/filters/particle.py", "typing_extensions.TypeVar"),
    *(
        ("dynpf/kernels/compiler.py", name)
        for name in (
            "logging",
            "logging.getLogger",
            "os",
            "os.environ.get",
            "os.getuid",
            "os.path.expanduser",
            "pathlib.Path",
            "tempfile",
            "tempfile.TemporaryFile",
            "tempfile.gettempdir",
        )
    ),
}


def findings(source: str, file: str) -> list[str]:
    """Return one line for each forbidden import and name in the source of a file, named relative to the repository."""
    tree = ast.parse(source, file)
    found = {*_imports(tree), *_uses(tree, bindings(tree))}
    return [f"{file}:{line}: {name} {why}" for line, name, why in sorted(found) if (file, name) not in EXCEPTIONS]


def _imports(tree: ast.AST) -> Iterator[tuple[int, str, str]]:
    for line, name in imported(tree):
        # Importing numpy.random only binds a module: what is taken from it is judged where that is done.
        if name != "numpy.random" and (why := _objection(name)):
            yield line, name, why
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level > 1:
            yield node.lineno, "." * node.level, "leaves the package: name the module in full"
        if isinstance(node, ast.ImportFrom) and node.level == 1 and (node.module or "").startswith(_BESIDE):
            yield node.lineno, f".{node.module}", _MEASURES


def imported(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and full name of each module, and each name of one, that is imported in any scope."""
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=aliases):
                yield from ((node.lineno, alias.name) for alias in aliases)
            case ast.ImportFrom(module=str(module), names=aliases, level=0):
                yield from ((node.lineno, f"{module}.{alias.name}") for alias in aliases)


def bindings(tree: ast.AST) -> dict[str, str]:
    """Map each name that an import binds, in any scope, to what it stands for."""
    bound = {}
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=aliases):
                for alias in aliases:
                    root = alias.name.partition(".")[0]
                    bound[alias.asname or root] = alias.name if alias.asname else root
            case ast.ImportFrom(module=str(module), names=aliases, level=0):
                bound |= {alias.asname or alias.name: f"{module}.{alias.name}" for alias in aliases}
    return bound


def _uses(tree: ast.AST, bound: dict[str, str]) -> Iterator[tuple[int, str, str]]:
    modules = {"numpy.random", *MODULES}
    inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute | ast.Name) or not isinstance(node.ctx, ast.Load) or id(node) in inner:
            continue
        root, *rest = dotted(node)
        if root in bound:
            name = ".".join((bound[root], *rest))
            if why := _objection(name):
                yield node.lineno, name, why
            elif name in modules:
                yield node.lineno, name, "is a module, and may not be handed about"
        elif root in BUILTINS:
            yield node.lineno, root, BUILTINS[root]


def dotted(node: ast.expr) -> tuple[str, ...]:
    """Return the parts of a plain dotted name; ("",) for any other expression."""
    match node:
        case ast.Name(id=name):
            return (name,)
        case ast.Attribute(value=value, attr=attribute) if (start := dotted(value)) != ("",):
            return (*start, attribute)
    return ("",)


def is_experiment(name: str) -> bool:
    """Return whether a file or a module of a system is none of its nodes', but what is beside them."""
    return _EXPERIMENT.match(name) is not None


def _objection(name: str) -> str | None:
    if is_experiment(name):
        return _MEASURES
    if not any(within(name, module) for module in MODULES):
        return "is not among the modules of pure code"
    if any(within(name, allowed) for allowed in ALLOWED):
        return None
    return next((why for start, why in FORBIDDEN.items() if within(name, start)), None)


def within(name: str, module: str) -> bool:
    return name == module or name.startswith(f"{module}.")


def main() -> int:
    root = Path(__file__).parents[1]
    paths = [path for name in PURE for path in ([root / name] if name.endswith(".py") else (root / name).rglob("*.py"))]
    files = {path.relative_to(root).as_posix(): path for path in sorted(paths)}
    pure = {name: path for name, path in files.items() if not is_experiment(name)}
    found = [line for name, path in pure.items() for line in findings(path.read_text(), name)]
    print(
        "\n".join(found) or f"Pure code: {len(pure)} files, nothing forbidden.",
        file=sys.stderr if found else sys.stdout,
    )
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
