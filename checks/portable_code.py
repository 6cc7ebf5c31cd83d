"""Finds arithmetic whose bits depend on the machine: `python -m checks.portable_code` prints each finding, exits 1.

By allowing, not by forbidding: in all code that a node can reach, each name of numpy, cv2 and math that is used stands
in one list with the reason why its bits are the same everywhere. What has no such reason has a counterpart in
``dynpf.portable``. Also refused, wherever they stand: ``@``, powers, ``sum`` of numbers that may be
fractions (Python 3.12 compensates), sorting without kind="stable", complex numbers, casts from fractions to whole
numbers without bounds, iteration over sets, fast-math.

What it cannot see: types. ``**`` of an array by itself, a method of what is no array, an array of fractions that is
assigned into one of whole numbers, the contents of a constant, a loop over a set that came from elsewhere. For these
are the runs on other machines (docs/machines.md).
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

from checks.portable_names import CASTS, EXACT, METHODS
from checks.pure_code import bindings, dotted, imported, is_experiment

__all__ = ["PORTABLE", "findings"]

PORTABLE = (
    "dynpf",
    "protocol/dynpf_protocol",
    "formats/dynpf_formats/importers",
    "runtime/dynpf_runtime/faults.py",
    "runtime/dynpf_runtime/node.py",
    "services/dynpf_services/estimates.py",
    "services/dynpf_services/nodes.py",
    "systems/dynpf_systems",
)
APART = ("dynpf/__init__.py", "dynpf/filters/smoothing.py", "dynpf/metrics/", "dynpf/reference/")
"""What no node reaches, which is checked, too: measures of runs, smoothers, and the twins that kernels are held to."""

MODULES = ("numpy", "cv2", "math", "cmath", "statistics", "random", "decimal", "scipy")
_NAMES = {name for names in EXACT.values() for name in names}
_REVIEWED = {place for places in CASTS.values() for place in places}
_INTEGERS = {
    "int",
    *(f"numpy.{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)),
    *("numpy.intp", "numpy.int_", "numpy.integer"),
}
_SAFE_CASTS = {"no", "equiv", "safe", "same_kind"}
_TO_ARRAYS = {f"numpy.{name}" for name in ("array", "asarray", "ascontiguousarray", "require")}
Finding = tuple[int, str]


def findings(source: str, file: str) -> list[str]:
    """Return one line for each thing that is not portable in the source of a file, named relative to the repository."""
    tree = ast.parse(source, file)
    bound = bindings(tree) | _aliases(tree, bindings(tree))
    in_kernel = file.startswith("dynpf/kernels/")
    found = {
        *_names(tree, bound, in_kernel),
        *_operators(tree, in_kernel),
        *_calls(tree, bound),
        *_casts(tree, bound, file, in_kernel),
        *_sets(tree),
        *_imports(tree),
    }
    return [f"{file}:{line}: {what}" for line, what in sorted(found)]


def _aliases(tree: ast.AST, bound: dict[str, str]) -> dict[str, str]:
    """Map names that a module gives to types, such as ``_f = np.float32``, to what they stand for."""
    found = {}
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[target], value=value):
                pairs = [(target, value)]
                if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                    pairs = list(zip(target.elts, value.elts, strict=False))
                for name, meant in pairs:
                    root, *rest = dotted(meant)
                    if isinstance(name, ast.Name) and root in bound:
                        found[name.id] = ".".join((bound[root], *rest))
    return found


def _names(tree: ast.AST, bound: dict[str, str], in_kernel: bool) -> Iterator[Finding]:
    inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute | ast.Name) or not isinstance(node.ctx, ast.Load) or id(node) in inner:
            continue
        root, *rest = dotted(node)
        if isinstance(node, ast.Attribute) and node.attr in METHODS and root not in bound:
            yield node.lineno, f".{node.attr}: {METHODS[node.attr]}"
        name = ".".join((bound.get(root, ""), *rest))
        if name.partition(".")[0] not in MODULES:
            continue
        if name not in _NAMES:
            yield node.lineno, f"{name}: its bits are not known to be the same on every machine; see dynpf.portable"
        elif in_kernel and name.startswith("math."):
            yield (
                node.lineno,
                f"{name}: in kernels NumPy's name is meant, which numba makes the processor's own operation",
            )


def _operators(tree: ast.AST, in_kernel: bool) -> Iterator[Finding]:
    for node in ast.walk(tree):
        match node:
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                yield node.lineno, "@: BLAS sums in an order of its own; take dynpf.portable.product"
            case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
                square = in_kernel and _literal(exponent, 2)  # which numba multiplies
                if not (square or _literal(base, 2) or (_number(base) and _number(exponent))):
                    yield node.lineno, "**: a number's square, too, comes from the C library; multiply, or numpy.square"
            case ast.AugAssign(op=ast.Pow()):
                yield node.lineno, "**=: a number's square, too, comes from the C library; multiply, or numpy.square"
            case ast.Constant(value=complex()):
                yield (
                    node.lineno,
                    "a complex number: products of such are rounded once or twice, as the processor has it",
                )


def _calls(tree: ast.AST, bound: dict[str, str]) -> Iterator[Finding]:
    picked = _picked(tree)
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        keywords = {keyword.arg: keyword.value for keyword in node.keywords}
        for flag in ("fastmath", "parallel"):
            if flag in keywords:
                yield node.lineno, f"{flag}: may change the order of operations"
        root, *rest = dotted(node.func)
        name = ".".join((bound.get(root, root), *rest))
        if (name == "numpy.argsort" or _method(node.func) == "argsort") and not _literal(
            keywords.get("kind"), "stable"
        ):
            yield node.lineno, 'sorting without kind="stable": the order of equal values is the processor\'s'
        if name == "sum" and node.args and not _whole(node.args[0], bound):
            yield (
                node.lineno,
                "sum: Python 3.12 adds fractions otherwise; take math.fsum, numpy.sum, or int(...) of whole ones",
            )
        if name == "numpy.partition" and id(node) not in picked:
            yield node.lineno, "numpy.partition: only the value in its place is fixed; take numpy.partition(x, k)[k]"
        if name == "numpy.arange" and any(_fraction(argument) for argument in node.args):
            yield node.lineno, "numpy.arange of fractions: rounded once or twice; multiply whole numbers instead"
        if name in {"complex", "pow", "numpy.vectorize"}:
            yield node.lineno, f"{name}: is not known to give the same bits on every machine"


def _picked(tree: ast.AST) -> set[int]:
    """Return the identities of calls f(x, k) of which no more is taken than [k]."""
    return {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Call) and len(node.value.args) == 2
        if ast.dump(node.value.args[1]) == ast.dump(node.slice)
    }


def _casts(tree: ast.AST, bound: dict[str, str], file: str, in_kernel: bool) -> Iterator[Finding]:
    """Find casts to whole numbers: out of range, and of NaN, each processor has its own answer."""
    for function, node in _within_functions(tree):
        if not isinstance(node, ast.Call) or (file, function) in _REVIEWED:
            continue
        keywords = {keyword.arg: keyword.value for keyword in node.keywords}
        kind = _type(node.func, bound)
        if isinstance(node.func, ast.Attribute) and node.func.attr == "astype":
            to = keywords.get("dtype", node.args[0] if node.args else None)
            safe = any(_literal(keywords.get("casting"), casting) for casting in _SAFE_CASTS)
            if _is_whole_type(to, bound) and not safe:
                yield (
                    node.lineno,
                    f'astype to whole numbers in {function}: take dynpf.portable.whole, or casting="same_kind" of such',
                )
        elif kind in _TO_ARRAYS and node.args:
            to = keywords.get("dtype", node.args[1] if len(node.args) > 1 else None)
            # Python's own numbers, unlike those of an array, are refused where they do not fit.
            listed = isinstance(node.args[0], ast.List | ast.ListComp | ast.Tuple)
            if _is_whole_type(to, bound) and not listed:
                yield node.lineno, f"{kind} of whole numbers in {function}: take astype with casting, or bound it"
        elif kind in (_INTEGERS if in_kernel else _INTEGERS - {"int"}) and node.args:
            known = _whole(node.args[0], bound) or _constant(node.args[0])
            if not known:
                what = f"{kind}(...) in {function}: bound it, and give the reason in checks/portable_names.py"
                yield node.lineno, what


def _sets(tree: ast.AST) -> Iterator[Finding]:
    """Find where the order of a set, which differs between processes, can come to light."""
    named = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and _is_set(node.value, frozenset())
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        match node:
            case ast.For(iter=source) | ast.comprehension(iter=source):
                ordered = [source]
            case ast.Call(func=ast.Name(id="list" | "tuple" | "enumerate" | "iter" | "next"), args=[source, *_]):
                ordered = [source]
            case ast.Starred(value=source):
                ordered = [source]
            case _:
                continue
        for source in ordered:
            if _is_set(source, frozenset(named)):
                yield source.lineno, "the order of a set differs between processes: take sorted(...)"


def _imports(tree: ast.AST) -> Iterator[Finding]:
    apart = tuple(name.removesuffix(".py").replace("/", ".") for name in APART if "__init__" not in name)
    for line, name in imported(tree):
        if name.startswith(apart):
            yield line, f"{name}: is not held to be portable; a node may not reach it"


def _within_functions(tree: ast.AST, function: str = "") -> Iterator[tuple[str, ast.AST]]:
    for node in ast.iter_child_nodes(tree):
        inside = node.name if isinstance(node, ast.FunctionDef) and not function else function
        yield inside, node
        yield from _within_functions(node, inside)


def _type(node: ast.expr, bound: dict[str, str]) -> str:
    root, *rest = dotted(node)
    return ".".join((bound.get(root, root), *rest))


def _is_whole_type(node: ast.expr | None, bound: dict[str, str]) -> bool:
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str) and "int" in node.value
    return node is not None and _type(node, bound) in _INTEGERS


def _whole(node: ast.expr, bound: dict[str, str]) -> bool:
    """Return whether terms are whole numbers as they stand: counts, truth values, bits, what is cast already."""
    match node:
        case ast.GeneratorExp(elt=term) | ast.ListComp(elt=term):
            return _whole(term, bound)
        case ast.Constant(value=int()) | ast.Compare() | ast.UnaryOp(op=ast.Not() | ast.Invert()):
            return True
        case ast.BoolOp(values=values):
            return all(_whole(value, bound) for value in values)
        case ast.Call(func=ast.Name(id="len" | "bool" | "isinstance")):
            return True
        case ast.Call(func=function):
            return _type(function, bound) in _INTEGERS
        case ast.BinOp(op=ast.LShift() | ast.RShift() | ast.BitAnd() | ast.BitOr() | ast.BitXor()):
            return True
        case ast.BinOp(left=left, right=right, op=ast.Add() | ast.Sub() | ast.Mult()):
            return _whole(left, bound) and _whole(right, bound)
    return False


def _is_set(node: ast.expr, named: frozenset[str]) -> bool:
    match node:
        case ast.Set() | ast.SetComp():
            return True
        case ast.Call(func=ast.Name(id="set" | "frozenset")):
            return True
        case ast.Call(func=ast.Attribute(attr="union" | "intersection" | "difference" | "symmetric_difference")):
            return True
        case ast.BinOp(left=left, right=right, op=ast.BitOr() | ast.BitAnd() | ast.Sub() | ast.BitXor()):
            return _is_set(left, named) or _is_set(right, named)
        case ast.Name(id=name):
            return name in named
    return False


def _method(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else ""


def _literal(node: ast.expr | None, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


def _number(node: ast.expr) -> bool:
    if isinstance(node, ast.UnaryOp | ast.BinOp):
        return all(_number(part) for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr))
    return isinstance(node, ast.Constant)


def _constant(node: ast.expr) -> bool:
    """Return whether this is made of numbers and of names in capitals, which a module gives to constants."""
    if isinstance(node, ast.UnaryOp | ast.BinOp):
        return all(_constant(part) for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr))
    return isinstance(node, ast.Constant) or (isinstance(node, ast.Name) and node.id.isupper())


def _fraction(node: ast.expr) -> bool:
    match node:
        case ast.Call(func=ast.Name(id="int" | "len" | "round"), args=[_]):
            return False
        case ast.Call(func=ast.Attribute(value=ast.Name(id="math"), attr="ceil" | "floor" | "trunc")):
            return False
        case ast.Constant(value=float()) | ast.BinOp(op=ast.Div()):
            return True
    return any(_fraction(part) for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr))


def main() -> int:
    root = Path(__file__).parents[1]
    paths = [
        path for name in PORTABLE for path in ([root / name] if name.endswith(".py") else (root / name).rglob("*.py"))
    ]
    files = {path.relative_to(root).as_posix(): path for path in sorted(paths)}
    checked = {name: path for name, path in files.items() if not name.startswith(APART) and not is_experiment(name)}
    found = [line for name, path in checked.items() for line in findings(path.read_text(), name)]
    print(
        "\n".join(found) or f"Portable code: {len(checked)} files, nothing that depends on the machine.",
        file=sys.stderr if found else sys.stdout,
    )
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
