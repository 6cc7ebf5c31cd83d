"""Environments of commits: this one if it has what a lock pins, else one made by pip and kept for the next time."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from dynpf_protocol.errors import RunError
from dynpf_runtime.progress import show_progress

__all__ = ["LOCK", "cache_folder", "environment", "install", "search_path"]

LOCK = "requirements.lock"

_PIN = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==([^\s;\\]+)(.*)$", re.MULTILINE)


def cache_folder() -> Path:
    """Return the folder in which environments are kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dynpf" / "environments"


def install(folder: Path, lock: Path) -> None:
    """Make an environment in a folder with what a lock pins; raises RunError with pip's last word."""
    pip = ("-m", "pip", "--disable-pip-version-check", "--quiet", "install")
    _run(sys.executable, "-m", "venv", str(folder))
    _run(str(_python(folder)), *pip, "--require-hashes", "--requirement", str(lock))


def environment(worktree: Path, cache: Path, install: Callable[[Path, Path], None] = install) -> Path:
    """Return the Python of an environment that has what the lock of a commit pins; a commit without one has this one.

    Raises RunError if it cannot be made.
    """
    lock = worktree / LOCK
    if not lock.is_file() or _is_here(lock.read_text(encoding="utf-8")):
        return Path(sys.executable)
    digest = hashlib.sha256(lock.read_bytes() + sys.version.encode()).hexdigest()[:16]
    folder = cache / digest
    if not folder.is_dir():
        cache.mkdir(parents=True, exist_ok=True)
        show_progress(f"installing {LOCK} into {folder}")
        # It gets its name when it is whole. That its commands name another folder does not matter: they are not used.
        made = Path(tempfile.mkdtemp(prefix=f"{digest}-", dir=cache))
        try:
            install(made, lock)
            made.replace(folder)
        except BaseException:
            shutil.rmtree(made, ignore_errors=True)
            raise
    return _python(folder)


def search_path(worktree: Path) -> list[str]:
    """Return the folders of dynpf's packages in a worktree of it; none in one of something else."""
    packages = sorted(worktree.glob("*/dynpf_*/"))
    return list(dict.fromkeys([str(worktree), *(str(package.parent) for package in packages)])) if packages else []


def _is_here(lock: str) -> bool:
    """Return whether this environment has one of the versions of every package that a lock names for it."""
    pinned: defaultdict[str, set[str]] = defaultdict(set)
    conditional = set()
    for name, pin, marker in _PIN.findall(lock):
        pinned[name].add(pin)
        if ";" in marker:
            conditional.add(name)
    for name, versions in pinned.items():
        try:
            if version(name) not in versions:
                return False
        except PackageNotFoundError:
            if name not in conditional:
                return False
    return True


def _python(folder: Path) -> Path:
    return folder / "bin" / "python"


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no reason given"]
        raise RunError(f"the environment of {LOCK} cannot be made: {' '.join(command[1:3])}: {lines[-1]}")
