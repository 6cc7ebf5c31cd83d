"""Signatures of recordings: ed25519 over every byte of the file, in a file of their own beside it.

A signature inside the file could not cover the checksums and the summary that MCAP puts after it; beside the file it
covers every byte, the file stays what every MCAP reader knows, and nothing is written into a closed recording.
"""

import base64
import binascii
import hashlib
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from dynpf_protocol.errors import UsageError

from dynpf_formats.certificates import (
    Identity,
    common_name,
    is_authority,
    issued_by,
    load_certificate,
    load_identity,
    read_certificate,
)
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.regular_files import open_regular, read_regular

__all__ = ["Signed", "load_signer", "read_signature", "sign", "signature_file"]

_FORMAT = "dynpf-signature-1"
_MOST_BYTES = 65_536


class _Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of a signature file; the signature is over all the rest."""

    format: str
    sha256: str  # of the recording
    signed_at: str  # by the signer's clock
    certificate: str  # PEM
    signature: str = ""  # base64


class Signed(NamedTuple):
    """Who signed a recording. ``problem`` says why the signature does not hold, or is empty."""

    name: str
    fingerprint: str  # SHA-256 of the public key
    signed_at: str
    trusted: bool
    problem: str


def signature_file(recording: Path) -> Path:
    """Return the path of a recording's signature."""
    return recording.with_name(f"{recording.name}.sig")


def load_signer(key: Path, now: datetime) -> Identity:
    """Return the key in NAME.key, with the certificate NAME.pem beside it.

    Raises UsageError if they do not fit, and for a certificate that does not hold now or is an authority's: nobody
    would believe the signature.
    """
    certificate = key.with_suffix(".pem")
    signer = load_identity(certificate, key)
    issued = signer.certificate
    if not issued.not_valid_before_utc <= now <= issued.not_valid_after_utc:
        raise UsageError(f"{certificate}: holds {_period(issued)}, not now; dynpf keys issue makes a new one")
    if is_authority(issued):
        raise UsageError(f"{certificate}: is an authority's, which signs certificates; take the key of a process")
    return signer


def _period(certificate: x509.Certificate) -> str:
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return f"from {begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC"


def sign(recording: Path, signer: Identity, now: datetime) -> Path:
    """Sign the bytes of a recording and return the signature's path; an older signature is replaced.

    Raises RecordingError if a file cannot be read or written.
    """
    unsigned = _Document(
        format=_FORMAT,
        sha256=_sha256(recording),
        signed_at=now.astimezone(UTC).isoformat(timespec="seconds"),
        certificate=signer.certificate_pem.decode(),
    )
    signature = base64.b64encode(signer.key.sign(_statement(unsigned))).decode()
    path = signature_file(recording)
    try:
        path.write_bytes(msgspec.json.encode(msgspec.structs.replace(unsigned, signature=signature)) + b"\n")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def read_signature(recording: Path, trust: Path | None, now: datetime) -> Signed | None:
    """Return who signed a recording, or None if it has no signature file.

    ``trust`` is the certificate of the authority that is believed. Raises UsageError if it is none.
    """
    authority = None if trust is None else load_certificate(trust)
    path = signature_file(recording)
    try:
        data = read_regular(path, _MOST_BYTES)
    except FileNotFoundError:
        return None
    except OSError as error:
        return Signed("", "", "", False, f"{path}: cannot be read: {error.strerror}")
    try:
        return _checked(msgspec.json.decode(data, type=_Document), recording, authority, now)
    except (ValueError, RecursionError):  # also what msgspec raises
        return Signed("", "", "", False, f"{path}: is no signature of a recording")


def _checked(document: _Document, recording: Path, authority: x509.Certificate | None, now: datetime) -> Signed:
    certificate = read_certificate(document.certificate.encode())
    public = _public_bytes(certificate)
    if document.format != _FORMAT or public is None:
        raise ValueError("not an ed25519 signature of this format")
    problem = _problem(document, public, recording)
    trusted = False
    if authority is not None and not problem:
        problem = _distrust(certificate, authority, datetime.fromisoformat(document.signed_at), now)
        trusted = not problem
    return Signed(common_name(certificate), hashlib.sha256(public).hexdigest(), document.signed_at, trusted, problem)


def _problem(document: _Document, public: bytes, recording: Path) -> str:
    try:
        signature = base64.b64decode(document.signature, validate=True)
        Ed25519PublicKey.from_public_bytes(public).verify(signature, _statement(document))
    except (InvalidSignature, binascii.Error):
        return "the signature is not that of its key"
    if _sha256(recording) != document.sha256:
        return "the file is not the one that was signed"
    return ""


def _distrust(certificate: x509.Certificate, authority: x509.Certificate, signed_at: datetime, now: datetime) -> str:
    """Return why the certificate is not believed, or an empty text."""
    if not issued_by(certificate, authority):
        return "the signer's certificate is not of the trusted authority"
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if signed_at.tzinfo is None or not begin <= signed_at <= end or signed_at > now:
        return f"signed at {signed_at.isoformat()}, when the certificate was not valid: {_period(certificate)}"
    return ""


def _public_bytes(certificate: x509.Certificate) -> bytes | None:
    public = certificate.public_key()
    return public.public_bytes_raw() if isinstance(public, Ed25519PublicKey) else None


def _statement(document: _Document) -> bytes:
    return msgspec.json.encode(msgspec.structs.replace(document, signature=""))


def _sha256(path: Path) -> str:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
