"""Packages that only some things need, and that are installed with an extra of dynpf-lab."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dynpf_protocol.errors import UsageError

__all__ = ["needing", "plotting"]


@contextmanager
def needing(package: str, *, extra: str, what: str) -> Iterator[None]:
    """Import within; raises UsageError that tells what to install where ``package`` is not there."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise UsageError(f"{what} needs the package {package}: pip install 'dynpf-lab[{extra}]'") from error


def plotting() -> Any:
    """Return matplotlib's pyplot, which then draws into files; raises UsageError where it is not installed."""
    with needing("matplotlib", extra="figures", what="drawing the figures of a study, whose rows are written,"):
        import matplotlib  # noqa: PLC0415
    matplotlib.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415

    return pyplot
