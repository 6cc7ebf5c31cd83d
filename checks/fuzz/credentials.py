"""Hostile keys, certificates and signatures: PEM files whose DER structure is edited, and signatures of recordings."""

import base64
import json
import shutil
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from random import Random

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from dynpf_formats.recording.signature import load_signer, read_signature, sign, signature_file
from dynpf_runtime.bus.keys import init, issue, load

from checks.fuzz.subjects import command
from checks.fuzz.trial import WrongAnswerError
from checks.fuzz.values import Values, as_json, torn

__all__ = ["changed_pem", "keys_trials", "signature_action", "write_keys"]

_CONSTRUCTED, _OCTET_STRING, _LONG_FORM = 0x20, 0x04, 0x80
_NAMES = ("estimator", "router", "ca", "", "x/y", "n" * 100, "\0", "a.b", "estimator@1")
_OTHERS = ("", "\0", "estimator\n" * 1000, "\udcff", "estimator@1", "x" * 100_000)


def write_keys(folder: Path) -> Path:
    """Make a folder of keys, with one key of another kind than dynpf's; each time other ones."""
    now = datetime.now(UTC)
    init(folder, now)
    issue(folder, ["estimator", "router"], now)
    private = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    (folder / "other.key").write_bytes(private)
    return folder


def keys_trials(
    random: Random, sound: Path, recording: Path, folder: Path
) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield the names and actions of what reads a folder of keys, of which one or two files are hostile."""
    keys = folder / "hostile-keys"
    shutil.copytree(sound, keys)
    for name in random.sample(("ca.pem", "ca.key", "estimator.pem", "estimator.key", "revoked"), random.choice((1, 2))):
        (keys / name).write_bytes(_changed_file(keys / name, random))
    name = random.choices(_NAMES, (20, *(1 for _ in _NAMES[1:])))[0]
    signed = folder / "signed.mcap"
    shutil.copyfile(recording, signed)
    yield "keys list", lambda: command("keys", "list", "--keys", keys)
    yield "keys load", lambda: load(keys, "estimator", datetime.now(UTC))
    yield "sign", lambda: command("sign", signed, "--key", keys / "estimator.key")
    yield (
        random.choice(("keys issue", "keys revoke")),
        lambda: command("keys", random.choice(("issue", "revoke")), "--keys", keys, "--", name),
    )
    shutil.rmtree(keys)


def _changed_file(path: Path, random: Random) -> bytes:
    if path.name == "revoked":
        return random.choice(_OTHERS).encode(errors="surrogateescape")
    if random.random() < 0.1:
        others = sorted(path.parent.glob("*.pem")) + sorted(path.parent.glob("*.key"))
        return random.choice(others).read_bytes()
    return changed_pem(path.read_bytes(), random)


def signature_action(random: Random, keys: Path, path: Path) -> Callable[[], object]:
    """Return the action that examines a recording beside a hostile signature; one of another file must not hold."""
    now = datetime.now(UTC)
    signature = sign(path, load_signer(keys / "estimator.key", now), now)
    data, values, other = signature.read_bytes(), Values(random), False
    match random.choice(("untouched", "document", "certificate", "torn", "recording")):
        case "document":
            data = as_json(values.changed(json.loads(data))).encode(errors="surrogatepass")
        case "certificate":
            document = json.loads(data)
            document["certificate"] = changed_pem(document["certificate"].encode(), random).decode(errors="replace")
            data = json.dumps(document).encode()
        case "torn":
            data = torn(data, random)
        case "recording":
            path.write_bytes(path.read_bytes() + b"\0")
            other = True
    signature.write_bytes(data)
    words: list[str | Path] = [*random.choice(("", "--json")).split()]
    if random.random() < 0.7:
        words = [*words, "--trust", _authority(random, keys)]

    def action() -> None:
        try:
            command("doctor", path, *words)
            found = read_signature(path, None, datetime.now(UTC))
            if other and (found is None or not found.problem):
                raise WrongAnswerError("the signature of another file holds")
        finally:
            signature_file(path).unlink(missing_ok=True)

    return action


def _authority(random: Random, keys: Path) -> Path:
    return random.choice((keys / "ca.pem", keys / "estimator.pem", keys / "other.key", keys / "missing.pem"))


def changed_pem(data: bytes, random: Random) -> bytes:
    """Return a PEM text with a value of its DER changed and every length made right, or torn bytes or text."""
    match random.random():
        case share if share < 0.1:
            return torn(data, random)
        case share if share < 0.15:
            return random.choice((b"", data * 2, data.replace(b"\n", b"\r\n"), data + b"\0", b"-----BEGIN X-----\n"))
    head, *body, tail = data.splitlines() or [b"", b""]
    der = base64.b64decode(b"".join(body))
    changed = torn(der, random) if random.random() < 0.2 else _changed_der(der, random)
    return b"\n".join((head, base64.encodebytes(changed).strip(), tail, b""))


def _changed_der(der: bytes, random: Random) -> bytes:
    """Change one value, tag or element, found by a walk from the root that may stop anywhere."""
    elements = _elements(der)
    if elements is None or not elements:
        return torn(der, random)
    place = random.randrange(len(elements))
    tag, content = elements[place]
    nested = tag & _CONSTRUCTED or (tag == _OCTET_STRING and _elements(content))
    if nested and random.random() < 0.9:
        elements[place] = (tag, _changed_der(content, random))
    else:
        match random.choice(("content", "content", "tag", "drop", "repeat", "empty", "large")):
            case "content":
                elements[place] = (tag, torn(content, random))
            case "tag":
                elements[place] = (random.choice((0x02, 0x05, 0x06, 0x0C, 0x13, 0x17, 0x18, 0x30, 0x31)), content)
            case "drop":
                del elements[place]
            case "repeat":
                elements[place:place] = [elements[place]] * random.choice((1, 1, 1000))
            case "empty":
                elements[place] = (tag, b"")
            case "large":
                elements[place] = (tag, content + random.randbytes(random.choice((1, 20, 5000))))
    return b"".join(bytes([tag]) + _length(len(content)) + content for tag, content in elements)


def _elements(der: bytes) -> list[tuple[int, bytes]] | None:
    """Return the tags and contents of a sequence of DER elements, or None if it is none."""
    found, place = [], 0
    while place < len(der):
        if place + 2 > len(der):
            return None
        tag, length, place = der[place], der[place + 1], place + 2
        if length & _LONG_FORM:
            octets = length & ~_LONG_FORM
            length, place = int.from_bytes(der[place : place + octets]), place + octets
        if place + length > len(der):
            return None
        found.append((tag, der[place : place + length]))
        place += length
    return found


def _length(length: int) -> bytes:
    if length < _LONG_FORM:
        return bytes([length])
    octets = length.to_bytes((length.bit_length() + 7) // 8)
    return bytes([_LONG_FORM | len(octets)]) + octets
