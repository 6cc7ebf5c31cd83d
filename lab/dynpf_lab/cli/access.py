"""How a command reaches the bus: the router's endpoint, and the keys by which it is let in."""

import argparse
import ipaddress
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import DEFAULT_PORT

if TYPE_CHECKING:
    from dynpf_runtime.bus.keys import Credentials

__all__ = ["credentials_of", "endpoint_of"]

SOON_S = 24 * 3600.0


def endpoint_of(options: argparse.Namespace, option: str = "connect") -> str:
    """Return the router's endpoint; raises UsageError if it does not fit --keys, or is open to others without."""
    given: str | None = getattr(options, option)
    if given is None:
        return f"{'tcp' if options.keys is None else 'tls'}/127.0.0.1:{DEFAULT_PORT}"
    if options.keys is not None and not given.startswith("tls/"):
        raise UsageError(f"--{option} {given}: with --keys it is tls/{given.partition('/')[2]}")
    if options.keys is None and given.startswith("tls/"):
        raise UsageError(f"--{option} {given}: takes keys: give --keys FOLDER (dynpf keys init makes one)")
    if options.keys is None and not options.insecure and not _on_loopback(given):
        raise UsageError(
            f"--{option} {given}: without keys anybody on that network could listen, speak and stop the run; "
            "give --keys FOLDER (dynpf keys init makes one) and tls/HOST:PORT, or say --insecure"
        )
    return given


def _on_loopback(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def credentials_of(options: argparse.Namespace, name: str, *, quiet: bool = False) -> "Credentials | None":
    """Return the credentials of ``name`` in --keys, None without; tells when they expire, raises UsageError if over."""
    if options.keys is None:
        return None
    from dynpf_runtime.bus.keys import load
    from dynpf_runtime.bus.terminal import say

    now = datetime.now(UTC)
    found = load(options.keys, name, now)
    soon = (found.expires - now).total_seconds() < SOON_S
    if soon or not quiet:
        hint = f"; renew it where the authority is: dynpf keys issue {name}" if soon else ""
        say(name, f"the certificate {found.certificate} expires on {found.expires:%Y-%m-%d %H:%M} UTC{hint}")
    return found
