"""``dynpf --version``: the versions of dynpf, Python, and the packages that dynpf needs."""

import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version

import dynpf

__all__ = ["versions"]


def versions() -> str:
    """Return two lines: dynpf's version with Python and the machine, and the versions of the packages it needs."""
    python = f"{platform.python_implementation()} {platform.python_version()}"
    first = f"dynpf {dynpf.__version__} ({python}, {platform.system()} {platform.machine()})"
    return "\n".join([first, ", ".join(f"{name} {version(name)}" for name in _needed())])


def _needed() -> list[str]:
    """Return the distributions that dynpf-lab requires, except the library."""
    try:
        lines = requires("dynpf-lab") or []
    except PackageNotFoundError:  # run from the sources, without being installed
        return []
    names = (re.split(r"[^\w.-]", line)[0] for line in lines if "extra ==" not in line)
    return sorted(name for name in names if name != "dynpf")
