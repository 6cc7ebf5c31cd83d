"""Optional packages, which extras of dynpf-lab install."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dynpf_protocol.errors import UsageError

__all__ = ["needing", "plotting"]


@contextmanager
def needing(package: str, *, extra: str, what: str) -> Iterator[None]:
    """Context for importing ``package``; raises UsageError that says what to install if it is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise UsageError(f"{what} needs the package {package}: pip install 'dynpf-lab[{extra}]'") from error


def plotting() -> Any:
    """Return matplotlib's pyplot with a backend for files; raises UsageError where it is not installed."""
    with needing("matplotlib", extra="figures", what="drawing them"):
        import matplotlib  # noqa: PLC0415
    matplotlib.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415

    return pyplot
