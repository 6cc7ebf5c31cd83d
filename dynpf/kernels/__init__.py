"""The hot loops, compiled by numba: one module a stage, each held to its twin in ``dynpf.reference``.

Importing numba takes longer than everything else together, so a module here is loaded when it is first asked for:
``from dynpf import kernels``, then ``kernels.motion.follow_arcs(...)``.
"""

from importlib import import_module
from types import ModuleType

__all__: list[str] = []


def __getattr__(name: str) -> ModuleType:
    try:
        return import_module(f"{__name__}.{name}")
    except ModuleNotFoundError as missing:
        if missing.name != f"{__name__}.{name}":
            raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
