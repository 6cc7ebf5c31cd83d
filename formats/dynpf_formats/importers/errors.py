"""Errors of the importers."""

from dynpf_protocol.errors import DynpfError

__all__ = ["ImportFailedError"]

SHOWN = 20


class ImportFailedError(DynpfError):
    """A foreign log cannot be imported. The text has one line per problem, with file, line and value."""

    def __init__(self, *problems: str) -> None:
        more = [f"and {len(problems) - SHOWN} more"] if len(problems) > SHOWN else []
        super().__init__("\n".join([*problems[:SHOWN], *more]))
        self.problems = problems
