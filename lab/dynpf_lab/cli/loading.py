"""Loading without looking for garbage: what is loaded stays until the process ends."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["loading"]


@contextmanager
def loading() -> Iterator[None]:
    """Hold the collector of cycles back while modules, kernels and nodes are loaded, and spare these from then on.

    It would look through them again and again: a fifth of the time that a short run takes.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
