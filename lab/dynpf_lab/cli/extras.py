"""Packages that only some commands need, and that are installed with an extra of dynpf-lab."""

from collections.abc import Iterator
from contextlib import contextmanager

from dynpf_protocol.errors import UsageError

__all__ = ["needing"]


@contextmanager
def needing(package: str, *, extra: str, what: str) -> Iterator[None]:
    """Import within; raises UsageError that tells what to install where ``package`` is not there."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise UsageError(f"{what} needs the package {package}: pip install 'dynpf-lab[{extra}]'") from error
