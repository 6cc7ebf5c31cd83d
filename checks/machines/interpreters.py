"""Interpreters that the jobs are run by beside the one that runs the matrix: other Pythons, other processors."""

import hashlib
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from dynpf_lab.references.table import CHECKOUT
from dynpf_protocol.errors import UsageError

from checks.machines.debian import CACHE, host_architecture, unpacked

__all__ = ["EMULATED", "Emulated", "Interpreter", "emulated", "further_pythons"]

VERSIONS = ((3, 11), (3, 12), (3, 13), (3, 14))
TRIXIE = (3, 13)  # the Python of Debian 13

_LIBRARIES = ("libstdc++6", "libgomp1", "zlib1g")  # that the wheels need of the system, and glibc with them


class Interpreter(NamedTuple):
    """How a Python is started, and where the locked packages for it are."""

    name: str
    command: tuple[str, ...]
    packages: Path
    kernels: str = ""  # folder of the kernels that it compiles; none: the checkout's own


class Emulated(NamedTuple):
    """Another processor: Debian's name of the architecture, Python's, QEMU's and its usual model."""

    architecture: str
    machine: str
    emulator: str
    model: str


EMULATED = {
    "arm64": Emulated("arm64", "aarch64", "qemu-aarch64-static", "neoverse-n1"),
    "old-x86": Emulated("amd64", "x86_64", "qemu-x86_64-static", "Nehalem"),
}
"""Nehalem is the oldest whose instructions NumPy's wheels take for granted; it has neither AVX nor FMA."""


def emulated(name: str, model: str = "") -> Interpreter:
    """Return Python 3.11 of Debian 12 on another processor, in QEMU's user-mode emulation."""
    kind = EMULATED[name]
    model = model or kind.model
    emulator = unpacked("bookworm", host_architecture(), ("qemu-user-static",)) / "usr/bin" / kind.emulator
    root = unpacked("bookworm", kind.architecture, ("libpython3.11-stdlib", "python3.11-minimal", *_LIBRARIES))
    command = (str(emulator), "-cpu", model, "-L", str(root), str(root / "usr/bin/python3.11"))
    return Interpreter(f"{name} ({model})", command, locked_packages((3, 11), kind.machine), f"{name}-{model}")


def further_pythons() -> Iterator[Interpreter]:
    """Yield the Pythons of other versions that are installed here, and Debian 13's."""
    machine = platform.machine()
    for version in VERSIONS:
        found = _installed(version)
        if found is not None and version != sys.version_info[:2]:
            name = "Python {}.{}".format(*version)
            yield Interpreter(name, (found,), locked_packages(version, machine))
    architecture = host_architecture()
    root = unpacked("trixie", architecture, ("libpython3.13-stdlib", "python3.13-minimal", *_LIBRARIES))
    loaders = [*root.glob("lib*/ld-linux-*.so.*")]
    if not loaders:
        raise UsageError(f"{root}: holds no dynamic loader; delete the folder to have it unpacked anew")
    libraries = root / "usr/lib" / f"{machine}-linux-gnu"
    command = (str(loaders[0]), "--library-path", str(libraries), str(root / "usr/bin/python3.13"))
    yield Interpreter("Debian 13's Python 3.13", command, locked_packages(TRIXIE, machine))


def _installed(version: tuple[int, int]) -> str | None:
    """Return the path of an interpreter on PATH that is really of this version."""
    path = shutil.which("python{}.{}".format(*version))
    if path is None:
        return None
    told = [path, "-c", "import sys; print(sys.version_info[:2], sys.executable)"]
    ended = subprocess.run(told, capture_output=True, text=True, check=False)
    return ended.stdout.split()[-1] if ended.returncode == 0 and ended.stdout.startswith(f"{version}") else None


def locked_packages(version: tuple[int, int], machine: str) -> Path:
    """Return a folder with the locked packages for a Python and a processor; the first call installs them."""
    lock = CHECKOUT / "requirements.lock"
    digest = hashlib.sha256(lock.read_bytes()).hexdigest()[:12]
    number = "{}{}".format(*version)
    folder = CACHE / "packages" / f"cp{number}-{machine}-{digest}"
    if folder.is_dir():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    tags = [f"manylinux_2_{minor}_{machine}" for minor in (28, 27, 17)] + [f"manylinux2014_{machine}"]
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix="new-") as temporary:
        new = Path(temporary) / "packages"
        command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "install"]
        command += ["--target", str(new), "--only-binary", ":all:", "--implementation", "cp"]
        command += ["--python-version", number, *(f"--platform={tag}" for tag in tags)]
        command += [*(f"--abi={abi}" for abi in (f"cp{number}", "abi3", "none"))]
        command += ["--require-hashes", "--requirement", str(lock)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise UsageError(f"pip could not install the locked packages for {machine}: {ended.stderr.strip()[-600:]}")
        new.rename(folder)
    return folder
