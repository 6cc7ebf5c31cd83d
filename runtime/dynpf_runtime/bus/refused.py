"""Whom the router refuses: a line for each kind of refusal, and a few more if there are many."""

import os
import re
import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection
from typing import Final

import zenoh

__all__ = ["Refused", "tell_tls_refusals"]


class Refused:
    """Tells the 1st, 10th, 100th ... refusal of a kind; may be called by any thread."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    def connection(self, reason: str, kind: str = "") -> None:
        """Note that a connection was refused; those of one ``kind``, by default the reason, are counted together."""
        with self._lock:
            self._counts[kind or reason] += 1
            count = self._counts[kind or reason]
        if count == 1:
            self._tell(f"a connection was refused: {reason}")
        elif set(str(count)[1:]) == {"0"} and str(count)[0] == "1":
            self._tell(f"{count} connections were refused: {reason}")

    def watch_names(self, known: Collection[str]) -> Callable[[str, str], None]:
        """Return what to call with the common name and the address of each client that has connected.

        Zenoh lets in who has a certificate of the authority; a name without a grant hears and says nothing.
        """

        def linked(name: str, address: str) -> None:
            if name not in known:
                self.connection(
                    f"{address} has a certificate of the name {name[:64]!r}, which is revoked or takes no part in this "
                    "run; it hears nothing, and nothing of it is heard",
                    name[:64],
                )

        return linked


_LINE: Final = re.compile(r"zenoh_link_tls::\w+: (.*?)(\. Hint:.*)?$")
_COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")
_WORDS: Final = {
    "peer sent no certificates": "it showed no certificate",
    "received corrupt message": "it spoke no TLS; processes without keys cannot take part",
    "certificate expired": "its certificate has expired",
    "certificate not valid yet": "its certificate does not hold yet",
    "BadSignature": "its certificate is not of this authority",
    "UnknownIssuer": "its certificate is not of this authority",
    "CaUsedAsEndEntity": "it showed the certificate of an authority",
    "InvalidPurpose": "its certificate is not for connecting",
}


def tell_tls_refusals(refused: Refused) -> None:
    """Note, from now on until the process ends, which connections fail before Zenoh knows who it is.

    Only Zenoh's log has that. It goes to standard output, which this takes over; a line of it that is about something
    else (RUST_LOG) goes to standard error.
    """
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    zenoh.init_log_from_env_or("zenoh_link_tls=warn")
    threading.Thread(target=_read, args=(reading, refused), daemon=True).start()


def _read(reading: int, refused: Refused) -> None:
    with open(reading, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            found = _LINE.search(_COLOUR.sub("", line).rstrip())
            if found is None:
                sys.stderr.write(line)
            else:
                refused.connection(next((words for key, words in _WORDS.items() if key in found[1]), found[1]))
