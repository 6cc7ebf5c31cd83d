"""A folder of keys: the certificate authority, and a certificate with its key for each process of a run.

``ca.pem`` and ``ca.key`` are the authority's; nobody but who issues certificates needs ``ca.key``. ``NAME.pem`` and
``NAME.key`` are those of the process NAME, with ``.`` for ``/``. ``revoked`` has the names of withdrawn certificates,
one a line: a process whose certificate was withdrawn gets its next one under another name, NAME@1, NAME@2 and so on.
"""

import os
import re
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from dynpf_formats.certificates import (
    AUTHORITY_DAYS,
    DAYS,
    Identity,
    common_name,
    issued_by,
    load_certificate,
    load_identity,
    new_authority,
    new_identity,
)
from dynpf_protocol.errors import UsageError
from dynpf_protocol.keys import OBSERVER, OPERATOR, ROUTER

__all__ = [
    "GUESTS",
    "LOCAL_HOSTS",
    "Credentials",
    "Issued",
    "current_name",
    "init",
    "issue",
    "issued",
    "load",
    "process_of",
    "remove_keys",
    "revoke",
    "revoked",
    "run_keys",
]

GUESTS = (OBSERVER, OPERATOR)
"""Who is no process of a run, and has keys of it."""

LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
"""Where the router may be reached without ``--host``."""

_AUTHORITY = "ca"
_REVOKED = "revoked"
_PRIVATE, _PUBLIC = 0o600, 0o644
_NAME = re.compile(r"[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*")


class Credentials(NamedTuple):
    """The files by which a process proves who it is, and knows the others."""

    name: str
    folder: Path
    authority: Path
    certificate: Path
    key: Path
    expires: datetime


class Issued(NamedTuple):
    """A certificate in a folder: its common name, and when it expires."""

    common_name: str
    expires: datetime


def init(folder: Path, now: datetime, days: float = AUTHORITY_DAYS) -> datetime:
    """Make ``folder``, for its owner alone, with a new authority; return when that expires. Raises UsageError."""
    if (folder / "ca.pem").exists() or (folder / "ca.key").exists():
        raise UsageError(f"{folder}: has a certificate authority already; choose another folder or remove it")
    _make(folder)
    authority = new_authority(now, days)
    _write(folder, _AUTHORITY, authority)
    _write_file(folder / _REVOKED, b"")
    return authority.certificate.not_valid_after_utc


def issue(
    folder: Path,
    names: Iterable[str],
    now: datetime,
    *,
    days: float = DAYS,
    hosts: Sequence[str] = LOCAL_HOSTS,
    for_containers: bool = False,
) -> list[Issued]:
    """Write a new key and certificate for each process; the router's is for ``hosts``. Raises UsageError.

    A container's user owns no file here. ``for_containers`` lets everybody read the keys who may open the folder, which
    is its owner alone, and who is handed one.
    """
    authority = _read(folder, _AUTHORITY)
    _check_time(authority.certificate, folder / "ca.pem", now, "make a new authority: dynpf keys init")
    withdrawn = revoked(folder)
    found = []
    for name in names:
        stem, own = _stem(name), current_name(name, withdrawn)
        try:
            made = new_identity(authority, own, now, days=days, hosts=hosts if name == ROUTER else ())
        except ValueError as error:
            raise UsageError(f"{name!r}: no certificate can have this name: {error}") from error
        _write(folder, stem, made, 0o444 if for_containers else _PRIVATE)
        found.append(Issued(own, made.certificate.not_valid_after_utc))
    return found


@contextmanager
def run_keys(folders: Mapping[Path, Sequence[str]], now: datetime) -> Iterator[None]:
    """Have the keys of some processes in each folder, for one run on this machine, until the block ends.

    They are of an authority whose own key is forgotten at once. Raises UsageError for a folder that has keys already.
    """
    authority = new_authority(now, DAYS)
    made: list[Path] = []
    try:
        for folder, names in folders.items():
            _make(folder)
            if (folder / "ca.pem").exists():
                raise UsageError(f"{folder}: has keys already; choose a folder for the keys of this run alone")
            made.append(folder)
            _write_file(folder / "ca.pem", authority.certificate_pem)
            for name in names:
                hosts = LOCAL_HOSTS if name == ROUTER else ()
                _write(folder, _stem(name), new_identity(authority, name, now, hosts=hosts))
        yield
    finally:
        for folder in made:
            remove_keys(folder, folders[folder])


def remove_keys(folder: Path, names: Iterable[str]) -> None:
    """Remove the keys of processes of a run, and its authority's certificate; nothing else that is in ``folder``."""
    (folder / "ca.pem").unlink(missing_ok=True)
    for stem in map(_stem, names):
        for suffix in (".pem", ".key"):
            (folder / f"{stem}{suffix}").unlink(missing_ok=True)


def revoke(folder: Path, name: str) -> tuple[str, list[Path]]:
    """Withdraw the certificate of a process and remove its files; return its common name and them. Raises UsageError.

    The files may have been moved to where the process runs.
    """
    stem, withdrawn = _stem(name), revoked(folder)
    own = current_name(name, withdrawn)
    _write_file(folder / _REVOKED, "".join(f"{one}\n" for one in (*withdrawn, own)).encode())
    removed = [path for suffix in (".pem", ".key") if (path := folder / f"{stem}{suffix}").exists()]
    for path in removed:
        path.unlink(missing_ok=True)
    return own, removed


def revoked(folder: Path) -> tuple[str, ...]:
    """Return the common names of withdrawn certificates; raises UsageError if they cannot be read."""
    try:
        return tuple((folder / _REVOKED).read_text(encoding="utf-8").split())
    except FileNotFoundError:
        return ()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{folder / _REVOKED}: cannot be read: {error}") from error


def current_name(name: str, withdrawn: Sequence[str]) -> str:
    """Return the common name of a process's certificate that counts when those of ``withdrawn`` do not."""
    count = 0
    while (own := f"{name}@{count}" if count else name) in withdrawn:
        count += 1
    return own


def process_of(common_name: str) -> str:
    """Return the process whose certificate has this name."""
    return common_name.partition("@")[0]


def issued(folder: Path) -> list[Issued]:
    """Return the certificates in a folder, the authority's first; raises UsageError if one cannot be read."""
    paths = sorted(folder.glob("*.pem"), key=lambda path: (path.stem != _AUTHORITY, path.stem))
    if not paths:
        raise UsageError(f"{folder}: has no certificates; dynpf keys init {folder} makes an authority")
    certificates = [load_certificate(path) for path in paths]
    return [Issued(common_name(one), one.not_valid_after_utc) for one in certificates]


def load(folder: Path, name: str, now: datetime) -> Credentials:
    """Return the credentials of the process ``name``; raises UsageError if they will not do, and says why."""
    authority = folder / "ca.pem"
    certificate, key = (folder / f"{_stem(name)}{suffix}" for suffix in (".pem", ".key"))
    trusted = load_certificate(authority)
    for path in (certificate, key):
        if not path.exists():
            raise UsageError(f"{path}: there is no such file; make one where the authority is: {_renewal(name)}")
    _check_private(key)
    own = _read(folder, _stem(name)).certificate
    if not issued_by(own, trusted):
        raise UsageError(f"{certificate}: is not of the authority in {authority}; all processes need the same one")
    if process_of(common_name(own)) != name:
        raise UsageError(f"{certificate}: is the certificate of {common_name(own)}, not of {name}")
    _check_time(trusted, authority, now, "make a new authority: dynpf keys init")
    _check_time(own, certificate, now, f"renew it where the authority is: {_renewal(name)}")
    return Credentials(name, folder, authority, certificate, key, own.not_valid_after_utc)


def _renewal(name: str) -> str:
    return f"dynpf keys issue {name} --keys FOLDER"


def _check_private(key: Path) -> None:
    """Raise UsageError for a key of this user's that others can read: the folder or the file must keep them out."""
    file, folder = key.stat(), key.parent.stat()
    own = not hasattr(os, "getuid") or file.st_uid == os.getuid()  # a container's user is handed another's
    if own and file.st_mode & 0o077 and folder.st_mode & 0o077:
        raise UsageError(f"{key}: others can read it; keep keys where they cannot (chmod 700 {key.parent})")


def _check_time(certificate: x509.Certificate, path: Path, now: datetime, remedy: str) -> None:
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now > end:
        raise UsageError(f"{path}: expired on {end:%Y-%m-%d %H:%M} UTC; {remedy}")
    if now < begin:
        raise UsageError(f"{path}: holds only from {begin:%Y-%m-%d %H:%M} UTC on; is the clock here right?")


def _stem(name: str) -> str:
    """Return the name of a process's files without suffix; raises UsageError if no process can be called so."""
    if _NAME.fullmatch(name) is None or name == _AUTHORITY:
        raise UsageError(f"{name!r}: no process can have keys under this name; expected a node's, such as estimator")
    return name.replace("/", ".")


def _read(folder: Path, stem: str) -> Identity:
    return load_identity(folder / f"{stem}.pem", folder / f"{stem}.key")


def _make(folder: Path) -> None:
    """Make a folder that only its owner may open; an existing one must be so."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        others = folder.stat().st_mode & 0o077
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made: {error.strerror}") from error
    if others:
        raise UsageError(f"{folder}: others may open it; keep keys in a folder of your own (chmod 700 {folder})")


def _write(folder: Path, stem: str, identity: Identity, mode: int = _PRIVATE) -> None:
    _write_file(folder / f"{stem}.key", identity.key_pem, mode)
    _write_file(folder / f"{stem}.pem", identity.certificate_pem, _PUBLIC)


def _write_file(path: Path, content: bytes, mode: int = _PUBLIC) -> None:
    """Write a file in one piece, under a mode that no umask changes; raises UsageError."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _PRIVATE), "wb") as file:
            file.write(content)
        draft.chmod(mode)
        draft.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
