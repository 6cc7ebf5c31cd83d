"""Loading without garbage collection: loaded objects stay until the process ends."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["loading"]


@contextmanager
def loading() -> Iterator[None]:
    """Suspend the cyclic garbage collector while modules, kernels and nodes are loaded, and exempt them afterwards.

    Scanning them repeatedly would take a fifth of the time of a short run.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
