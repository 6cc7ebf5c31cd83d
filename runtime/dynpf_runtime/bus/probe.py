"""Probe: why a router refuses a process. Zenoh itself only says that it is unable to connect."""

import socket
import ssl

from dynpf_runtime.bus.keys import Credentials

__all__ = ["refusal"]

TIMEOUT_S = 2.0
_OTHER_HOST = (62, 64)  # X509_V_ERR_HOSTNAME_MISMATCH, X509_V_ERR_IP_ADDRESS_MISMATCH of OpenSSL
ANSWER_S = 0.5
"""How long a router may take to refuse a certificate, which it says only after the handshake."""


def refusal(endpoint: str, keys: Credentials | None) -> str:
    """Return why the router at ``endpoint`` refuses a process with ``keys``, as the end of a sentence about it.

    The text is empty if nothing speaks against it, or nobody listens there.
    """
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    host = host.strip("[]")
    try:
        with (
            socket.create_connection((host, int(port)), TIMEOUT_S) as plain,
            _context(keys).wrap_socket(plain, server_hostname=host) as link,
        ):
            if keys is None:
                return "takes only processes that have a key: give --keys FOLDER, and its address as tls/HOST:PORT"
            link.settimeout(ANSWER_S)
            link.recv(1)
    except ssl.SSLCertVerificationError as error:
        if error.verify_code in _OTHER_HOST:
            return (
                f"has a certificate for another host than {host}; issue it with: dynpf keys issue router --host {host}"
            )
        return f"shows a certificate that {keys.authority if keys else 'nobody'} does not vouch for: {_words(error)}"
    except ssl.SSLError as error:
        if keys is None:
            return ""  # it speaks no TLS, as expected
        if "ALERT" in (error.reason or ""):
            return f"refuses the certificate {keys.certificate}: {_words(error)}"
        return "speaks no TLS: it was started without --keys"
    except OSError:
        return ""
    return ""


def _context(keys: Credentials | None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if keys is None:
        context.check_hostname = False  # nothing is sent, and nothing believed
        context.verify_mode = ssl.CERT_NONE
    else:
        context.load_verify_locations(keys.authority)
        context.load_cert_chain(keys.certificate, keys.key)
    return context


def _words(error: ssl.SSLError) -> str:
    """Return OpenSSL's reason in words."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return error.verify_message
    return (error.reason or str(error)).lower().partition("alert_")[2].replace("_", " ")
