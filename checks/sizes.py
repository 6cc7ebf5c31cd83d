"""Holds modules to 400 lines and functions to 60: `python -m checks.sizes` prints each that is longer and exits 1.

What is longer has more than one subject. A kernel may be longer where a split would cost what it is compiled for; each
such one is named here with its reason.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["too_long"]

PACKAGES = (
    *("benchmarks", "checks", "docs", "dynpf", "examples", "experiments", "formats", "lab", "protocol", "runtime"),
    *("services", "systems"),
)
MODULE_LINES, FUNCTION_LINES = 400, 60

LONGER = {
    ("dynpf/kernels/rays.py", "_aim"): "one loop without branches, which becomes vectors as a whole",
    ("dynpf/kernels/rays.py", "trace"): "hands the rows of its room to four loops by position, a line each",
}


def too_long(path: str, source: str) -> Iterator[str]:
    """Yield a line for the module at ``path`` and for each of its functions that is longer than it may be."""
    lines = source.count("\n")
    if lines > MODULE_LINES:
        yield f"{path}: {lines} lines; at most {MODULE_LINES}"
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno is not None:
            lines = node.end_lineno - node.lineno + 1
            if lines > FUNCTION_LINES and (path, node.name) not in LONGER:
                yield f"{path}:{node.lineno}: {node.name} has {lines} lines; at most {FUNCTION_LINES}"


def main() -> int:
    root = Path(__file__).parents[1]
    files = sorted(file for package in PACKAGES for file in (root / package).rglob("*.py"))
    found = [text for file in files for text in too_long(str(file.relative_to(root)), file.read_text("utf-8"))]
    print("\n".join(found) or f"Sizes: {len(files)} files, none too long, nor a function.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
