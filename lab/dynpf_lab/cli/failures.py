"""What is told of errors that no command has foreseen."""

import os
import traceback

from dynpf_protocol.errors import ProtocolError

__all__ = ["sentence"]


def sentence(error: Exception) -> str:
    """Return what to tell a person of an error that no command has foreseen: his file or system, or a fault of ours."""
    what = f"{type(error).__name__}: {error}"
    match error:
        case OSError(filename=str() | bytes() as name, strerror=str() as reason):
            return f"{os.fsdecode(name)}: {reason[:1].lower()}{reason[1:]}"
        case OSError():
            return f"the system refused something: {error.strerror or error}"
        case RecursionError():
            return "the input is nested too deeply to be read; what nests that deep is none of dynpf's files"
        case UnicodeError():
            return f"a text cannot be read or written here: {error}; dynpf's texts are UTF-8 (try LANG=C.UTF-8)"
        case ProtocolError():
            return f"a message breaks the protocol: {error}; dynpf doctor tells what is wrong with a recording"
        case _ if type(error).__module__.partition(".")[0] == "zenoh":
            return f"the bus failed: {str(error).partition(' at /')[0]}"
        case _:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            return (
                f"a fault of dynpf itself, not of yours: {what} ({frame.filename}:{frame.lineno}); please report it, "
                "with what DYNPF_TRACEBACK=1 shows in addition"
            )
