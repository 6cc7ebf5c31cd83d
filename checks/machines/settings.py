"""The settings under which the jobs are run: a table by what the processor has, without effects of its own."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from checks.machines.interpreters import Interpreter

__all__ = ["CHOOSERS", "DEFAULT", "SHORT", "Processor", "Setting", "processor_settings", "python_settings"]

CHOOSERS = (
    *("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE", "OPENBLAS_NUM_THREADS", "OPENBLAS_VERBOSE", "OMP_NUM_THREADS"),
    *("NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "OPENCV_CPU_DISABLE", "OPENCV_IPP", "GLIBC_TUNABLES"),
    *("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_NUM_THREADS", "NUMBA_OPT", "PYTHONHASHSEED", "PYTHONPATH"),
)
"""Variables that choose kernels: every run sets them or has none of them, whatever the environment says."""


class Processor(NamedTuple):
    """What the default run tells of the processor."""

    machine: str  # such as x86_64
    features: frozenset[str]  # by the names of Linux
    numpy_dispatched: tuple[str, ...]  # for which NumPy has further kernels, found on this processor
    opencv_dispatched: tuple[str, ...]  # for which OpenCV has, found on this processor
    glibc: bool


class Setting(NamedTuple):
    """One row of the matrix: variables or another interpreter, and the controls that should show it."""

    name: str
    environment: Mapping[str, str]
    controls: tuple[str, ...]
    interpreter: Interpreter | None = None  # None: the one that runs the matrix
    kernels: str = ""  # folder of the kernels that it compiles; none: the checkout's own


DEFAULT = Setting("default", {}, ())

# What each of OpenBLAS's choices needs of the processor, by the names of Linux.
_OPENBLAS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "x86_64": {
        "Prescott": ("pni",),
        "Core2": ("ssse3",),
        "Nehalem": ("sse4_2",),
        "Sandybridge": ("avx",),
        "Haswell": ("avx2", "fma"),
        "Zen": ("avx2", "fma"),
        "SkylakeX": ("avx512f", "avx512bw", "avx512dq", "avx512vl"),
        "Cooperlake": ("avx512vl", "avx512_bf16"),
        "SapphireRapids": ("avx512vl", "avx512_fp16", "amx_bf16"),
    },
    "aarch64": {
        "ARMV8": ("asimd",),
        "CORTEXA57": ("asimd",),
        "THUNDERX2T99": ("asimd",),
        "NEOVERSEN1": ("asimdhp", "asimddp"),
        "ARMV8SVE": ("sve",),
        "NEOVERSEV1": ("sve",),
    },
}

_GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "-avx,-avx2,-fma"}
_OLD_LIBM = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}

SHORT = ("all masks but Numba's",)
"""The settings of the short form: all choices at once for which no kernel of dynpf has to be compiled anew."""


def processor_settings(processor: Processor) -> Iterator[Setting]:
    """Yield the settings that choose other kernels on one processor."""
    kinds = [kind for kind, needed in _OPENBLAS.get(processor.machine, {}).items() if processor.features >= {*needed}]
    for kind in kinds:
        yield Setting(f"OpenBLAS {kind}", {"OPENBLAS_CORETYPE": kind}, ("products",))
    masks = [*_masks(processor)]
    yield from masks
    oldest = [Setting("", {"OPENBLAS_CORETYPE": kind}, ("products",)) for kind in kinds[:1]]
    yield _together("all masks but Numba's", [*oldest, *(mask for mask in masks if not mask.kernels)])
    yield _together("all masks", [*oldest, *masks])
    for count in ("1", "2"):
        threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), count)
        yield Setting(f"threads: {count}", threads, ("long dot",))
    yield Setting("another order of sets", {"PYTHONHASHSEED": "1"}, ("set order",))


def _together(name: str, masks: Sequence[Setting]) -> Setting:
    environment = {variable: value for mask in masks for variable, value in mask.environment.items()}
    controls = dict.fromkeys(control for mask in masks for control in mask.controls)
    return Setting(name, environment, tuple(controls), kernels=max((mask.kernels for mask in masks), default=""))


def _masks(processor: Processor) -> Iterator[Setting]:
    if processor.numpy_dispatched:
        names = " ".join(processor.numpy_dispatched)
        yield Setting("NumPy's baseline", {"NPY_DISABLE_CPU_FEATURES": names}, ("numpy",))
    if processor.opencv_dispatched:
        names = ",".join(processor.opencv_dispatched)
        yield Setting("OpenCV's baseline", {"OPENCV_CPU_DISABLE": names}, ("opencv",))
    if processor.machine == "x86_64":
        yield Setting("IPP for SSE4.2", {"OPENCV_IPP": "sse42"}, ("ipp",))
        yield Setting("no IPP", {"OPENCV_IPP": "disabled"}, ("ipp",))
        yield Setting("Numba for any x86-64", _GENERIC, ("numba",), kernels="generic")
        if processor.glibc:
            yield Setting("libm without FMA", _OLD_LIBM, ("libm",))


def python_settings(interpreters: Iterable[Interpreter]) -> Iterator[Setting]:
    """Yield a setting for each further interpreter."""
    for one in interpreters:
        yield Setting(one.name, {}, ("float sum",), one, kernels=one.kernels)
