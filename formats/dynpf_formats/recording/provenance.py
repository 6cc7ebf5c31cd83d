"""The provenance of a run: the code, the packages and the platform that made it."""

import ctypes
import hashlib
import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from llvmlite import binding

from dynpf_formats.recording.header import Provenance

__all__ = ["code_digest", "collect", "explain_different_bytes", "platform_fingerprint", "provenance_difference"]

_IN_WORDS = {
    "blas": "BLAS",
    "libm": "C library",
    "numpy_simd": "NumPy's vector instructions",
    "opencv_simd": "OpenCV's vector instructions",
    "opencv_ipp": "OpenCV's IPP",
    "numba_cpu": "numba's processor",
}
_CORE_NAMES = ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename", "openblas_get_corename")

_PACKAGES = (
    "dynpf",
    "dynpf_protocol",
    "dynpf_formats",
    "dynpf_runtime",
    "dynpf_services",
    "dynpf_experiments",
    "dynpf_systems",
    "dynpf_lab",
)
_DISTRIBUTIONS = (
    "eclipse-zenoh",
    "llvmlite",
    "mcap",
    "msgspec",
    "numba",
    "numpy",
    "opencv-python-headless",
    "pyyaml",
    "zstandard",
)


def collect() -> Provenance:
    """Return the provenance of runs that this process makes."""
    return Provenance(
        dynpf_version=_version("dynpf") or "unknown",
        code_digest=code_digest(),
        packages={name: found for name in _DISTRIBUTIONS if (found := _version(name))},
        platform=platform_fingerprint(),
    )


@cache  # what a process has loaded does not change
def code_digest() -> str:
    """Return the SHA-256 over names and contents of the source files of dynpf's packages."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        found = find_spec(package)
        if found is None or not found.submodule_search_locations:
            continue  # not installed: it had no part in the run
        root = Path(found.submodule_search_locations[0])
        for path in sorted(root.rglob("*.py"), key=lambda path: path.relative_to(root).as_posix()):
            source = path.read_bytes()
            name = f"{package}/{path.relative_to(root).as_posix()}"
            digest.update(f"{name} {len(source)}\n".encode())
            digest.update(source)
    return digest.hexdigest()


def platform_fingerprint() -> dict[str, str]:
    """Return what libraries choose kernels by. It is informative only: no bit of a result depends on it."""
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "libm": _with_setting(" ".join(platform.libc_ver()).strip() or "unknown", "GLIBC_TUNABLES"),
        "blas": _blas(),
        "numpy_simd": " ".join([*simd.get("baseline", ()), *simd.get("found", ())]) or "none",
        "opencv_simd": cv2.getCPUFeaturesLine() or "none",
        "opencv_ipp": cv2.ipp.getIppVersion() if cv2.ipp.useIPP() else "none",
        "numba_cpu": _with_setting(
            os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name(), "NUMBA_CPU_FEATURES"
        ),
    }


def provenance_difference(made: Provenance, other: Provenance, here: str = "here") -> str:
    """Return a sentence on the first difference between packages and platforms of two runs, empty if there is none.

    An entry that only one run has is no difference: older recordings have fewer.
    """
    for name in {**made.packages, **other.packages}:
        a, b = (run.packages.get(name, "none") for run in (made, other))
        if a != b:
            return f"recorded with {name} {a}, {here} {b}"
    for name, a in made.platform.items():
        if a != (b := other.platform.get(name, a)):
            return f"recorded with {_IN_WORDS.get(name, name)} {a}, {here} {b}"
    return ""


def explain_different_bytes(made: Provenance, other: Provenance, here: str = "here") -> str:
    """Return ``provenance_difference``, and what it means for two runs of one scenario whose bytes differ."""
    apart = provenance_difference(made, other, here)
    if not apart:
        return ""
    if made.packages != other.packages:
        return f"{apart}; bytes are promised for equal versions"
    if made.code_digest != other.code_digest:
        return f"{apart}; bytes should be the same all the same, but dynpf's code differs, too"
    return f"{apart}; bytes should be the same all the same: please report, unless code of your own takes part"


def _with_setting(value: str, variable: str) -> str:
    """Return a value, with the environment variable that changes its meaning if that is set."""
    setting = os.environ.get(variable)
    return f"{value} with {variable}={setting}" if setting else value


def _blas() -> str:
    """Return the name of NumPy's BLAS, its version, and the processor whose kernels it uses."""
    blas = np.show_config(mode="dicts")["Build Dependencies"].get("blas", {})
    name = " ".join(str(blas[key]) for key in ("name", "version") if blas.get(key)) or "unknown"
    numpy = find_spec("numpy._core._multiarray_umath")
    # The look-up includes the libraries that NumPy is linked with.
    library = ctypes.CDLL(numpy.origin) if numpy is not None and numpy.origin else None
    for symbol in _CORE_NAMES:
        core = getattr(library, symbol, None)
        if core is not None:
            core.restype = ctypes.c_char_p
            return f"{name} {core().decode()}"
    return _with_setting(name, "OPENBLAS_CORETYPE")


@cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
