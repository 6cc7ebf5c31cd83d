"""Where a run comes from: the code, the packages and the platform that its bytes depend on."""

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import cv2
import numpy as np

import dynpf
import protocol
import services
from services.recording.header import Provenance

__all__ = ["code_digest", "collect", "platform_fingerprint"]

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
    packages = {name: found for name in _DISTRIBUTIONS if (found := _version(name))}
    return Provenance(
        dynpf_version=_version("dynpf") or "unknown",
        code_digest=code_digest(),
        packages=packages,
        platform=platform_fingerprint(),
    )


def code_digest() -> str:
    """Return the SHA-256 over names and contents of the source files of dynpf, protocol and services."""
    digest = hashlib.sha256()
    for package in (dynpf, protocol, services):
        root = Path(package.__path__[0])
        for path in sorted(root.rglob("*.py"), key=lambda path: path.relative_to(root).as_posix()):
            source = path.read_bytes()
            name = f"{package.__name__}/{path.relative_to(root).as_posix()}"
            digest.update(f"{name} {len(source)}\n".encode())
            digest.update(source)
    return digest.hexdigest()


def platform_fingerprint() -> dict[str, str]:
    """Return what the bits of a floating-point result may depend on beside code and packages."""
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "numpy_simd": " ".join([*simd.get("baseline", ()), *simd.get("found", ())]),
        "opencv_simd": cv2.getCPUFeaturesLine(),
    }


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
