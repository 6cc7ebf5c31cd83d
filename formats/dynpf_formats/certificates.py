"""X.509 certificates of an authority of one's own and of the processes that it vouches for; their keys are ed25519.

By them processes prove on the bus who they are, and recordings are signed.
"""

import ipaddress
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple, Self

from cryptography import x509
from cryptography.exceptions import InternalError, InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from dynpf_protocol.errors import UsageError

from dynpf_formats.regular_files import read_regular

__all__ = [
    "AUTHORITY_DAYS",
    "DAYS",
    "Identity",
    "common_name",
    "is_authority",
    "issued_by",
    "load_certificate",
    "load_identity",
    "new_authority",
    "new_identity",
    "read_certificate",
]

AUTHORITY_DAYS = 365.0
DAYS = 7.0
"""How long a process's certificate holds: Zenoh has no revocation lists, so none holds for long."""

_LARGEST = 2**16  # bytes of a file with a certificate or a key
_UNREADABLE = (  # what cryptography raises of bad PEM
    *(ValueError, TypeError, UnsupportedAlgorithm, InternalError),
    *(x509.InvalidVersion, x509.UnsupportedGeneralNameType, x509.ExtensionNotFound, x509.DuplicateExtension),
)

SLACK = timedelta(minutes=5)
"""How far the clocks of two machines may differ when a certificate is new."""


class Identity(NamedTuple):
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: Ed25519PrivateKey

    @property
    def certificate_pem(self) -> bytes:
        """The certificate as PEM."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """The private key as PEM (PKCS #8), not encrypted."""
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )

    @classmethod
    def from_pem(cls, certificate: bytes, key: bytes) -> Self:
        """Return the identity in two PEM texts; raises ValueError if they are unreadable or do not belong together."""
        try:
            private = serialization.load_pem_private_key(key, password=None)
        except _UNREADABLE as error:
            raise ValueError("it is no private key in PEM without a password") from error
        if not isinstance(private, Ed25519PrivateKey):
            raise ValueError("it is no ed25519 key")
        identity = cls(read_certificate(certificate), private)
        if identity.certificate.public_key() != private.public_key():
            raise ValueError("it is another key than the certificate's")
        return identity


def new_authority(now: datetime, days: float = AUTHORITY_DAYS) -> Identity:
    """Return a new certificate authority, which signs its own certificate."""
    key = Ed25519PrivateKey.generate()
    builder = _builder(_name("dynpf certificate authority"), key, None, now, now + timedelta(days=days))
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_SIGNS_CERTIFICATES, critical=True)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    return Identity(builder.sign(key, None), key)


def new_identity(
    authority: Identity, common_name: str, now: datetime, *, days: float = DAYS, hosts: Sequence[str] = ()
) -> Identity:
    """Return a new key and a certificate for the process ``common_name``, which ends with its authority's.

    With ``hosts``, names and addresses at which it may be reached, it may listen; without, only connect. Raises
    ValueError for a name that is empty or has more than 64 characters.
    """
    key = Ed25519PrivateKey.generate()
    until = min(now + timedelta(days=days), authority.certificate.not_valid_after_utc)
    builder = _builder(_name(common_name), key, authority, now, until)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
    builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
    if hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName([_host(host) for host in hosts]), critical=False)
    return Identity(builder.sign(authority.key, None), key)


def read_certificate(pem: bytes) -> x509.Certificate:
    """Return a certificate that can be used; raises ValueError if anything in it that dynpf uses is unreadable."""
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        certificate.public_key()
        names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        ends = certificate.not_valid_before_utc < certificate.not_valid_after_utc
    except _UNREADABLE as error:
        raise ValueError("it is no certificate in PEM") from error
    if len(names) != 1 or not ends:
        raise ValueError("it does not say, once, whose it is, and from when to when it holds")
    return certificate


def load_certificate(path: Path) -> x509.Certificate:
    """Return the certificate in a file; raises UsageError if none can be read from it."""
    try:
        return read_certificate(read_regular(path, _LARGEST))
    except FileNotFoundError as error:
        text = "there is no such certificate; dynpf keys init makes an authority, dynpf keys issue the others"
        raise UsageError(f"{path}: {text}") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{path}: no certificate can be read from it: {error}") from error


def load_identity(certificate: Path, key: Path) -> Identity:
    """Return a certificate and its key in two files; raises UsageError if they are unreadable or do not fit."""
    load_certificate(certificate)
    try:
        return Identity.from_pem(read_regular(certificate, _LARGEST), read_regular(key, _LARGEST))
    except OSError as error:
        raise UsageError(f"{key}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{key}: no key of {certificate} can be read from it: {error}") from error


def common_name(certificate: x509.Certificate) -> str:
    """Return whose certificate it is."""
    (name,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(name.value)


def issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Return whether ``authority`` has signed ``certificate``."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (*_UNREADABLE, InvalidSignature):
        return False
    return True


def is_authority(certificate: x509.Certificate) -> bool:
    """Return whether a certificate is an authority's, which vouches for others."""
    try:
        return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except _UNREADABLE:
        return False


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    subject: x509.Name, key: Ed25519PrivateKey, issuer: Identity | None, now: datetime, until: datetime
) -> x509.CertificateBuilder:
    """Return what all certificates have; without an ``issuer``, the subject signs its own."""
    signs, by = (key, subject) if issuer is None else (issuer.key, issuer.certificate.subject)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(by).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number())
    builder = builder.not_valid_before(now - SLACK).not_valid_after(until)
    return builder.add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signs.public_key()), critical=False)


_SIGNS_CERTIFICATES = x509.KeyUsage(
    digital_signature=False,
    content_commitment=False,
    key_encipherment=False,
    data_encipherment=False,
    key_agreement=False,
    key_cert_sign=True,
    crl_sign=True,
    encipher_only=False,
    decipher_only=False,
)


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
