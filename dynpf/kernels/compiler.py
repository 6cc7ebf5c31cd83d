"""How kernels are compiled: when first called, once a machine and version of the sources, never with fast-math.

IEEE arithmetic without contraction or reordering gives the same bits whatever the vector width, so a kernel agrees
with itself on every slice of its particles. What numba compiles is kept on disk. Its own cache knows a kernel's file
alone and would keep one that calls a changed function of another file; so the folder is named by all the sources.

With NUMBA_BOUNDSCHECK=1 in the environment kernels check every index, and give the same bits more slowly.
"""

import hashlib
import logging
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config

__all__ = ["cache_folder", "device", "kernel"]

Function = Callable[..., Any]

_numba: Any = config


def kernel(function: Function) -> Function:
    """Compile a function that is called from Python: without the interpreter's lock, kept on disk."""
    chosen = _numba.CACHE_DIR
    folder = cache_folder()
    _numba.CACHE_DIR = "" if folder is None else str(folder)
    try:
        return numba.njit(nogil=True, error_model="numpy", cache=folder is not None)(function)
    finally:
        _numba.CACHE_DIR = chosen


def device(function: Function) -> Function:
    """Compile a function that only kernels call: it becomes part of each of them."""
    return numba.njit(nogil=True, error_model="numpy", forceinline=True)(function)


@cache
def cache_folder() -> Path | None:
    """Return where compiled kernels are kept, or None where nothing can be written.

    That is below NUMBA_CACHE_DIR if it is set, else beside the sources, else in the user's cache or the system's
    temporary folder. Says so when the folder is new, since the first calls will then take seconds.
    """
    name = f"dynpf-kernels-{_sources_digest()}{'-bounds' if _numba.BOUNDSCHECK else ''}"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - no error without a home
    own = Path(tempfile.gettempdir()) / f"dynpf-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    chosen = _numba.CACHE_DIR
    roots = [Path(chosen)] if chosen else [Path(__file__).parent / "__pycache__", Path(home), own]
    for root in roots:
        folder = root / name
        try:
            if root == own and not _private(own):
                continue  # what lies there is executed, and somebody else may have put it there
            new = _made(folder)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        if new:
            logging.getLogger("dynpf").warning("Compiling the kernels for this machine, once: a few seconds")
        return folder
    logging.getLogger("dynpf").warning("Compiling the kernels anew: no folder to keep them in (%s)", roots[0])
    return None


def _made(folder: Path) -> bool:
    """Make the folder; return whether it was this process that did, of several that may begin together."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        return False
    return True


def _private(folder: Path) -> bool:
    """Make a folder in a place that all may write to; return whether it is this user's, and nobody else's to change."""
    folder.mkdir(mode=0o700, exist_ok=True)
    about = folder.lstat()  # a link would be somebody else's to turn
    owned = not hasattr(os, "getuid") or about.st_uid == os.getuid()
    return folder.is_dir() and not folder.is_symlink() and owned and not about.st_mode & 0o022


def _sources_digest() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]
