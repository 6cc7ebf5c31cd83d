"""A signature holds for the bytes that were signed, and says whose key it was."""

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from dynpf_formats.recording.signature import load_signer, read_signature, sign, signature_file
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import UsageError

from tests.unit.recording.recorded_runs import lockstep, write

NOW = datetime(2030, 1, 1, 12, tzinfo=UTC)


def certificate(name: str, key: Ed25519PrivateKey, issuer: str, by: Ed25519PrivateKey) -> bytes:
    built = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)]))
        .issuer_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, issuer)]))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime(2020, 1, 1, tzinfo=UTC))  # commands take the time from the clock
        .not_valid_after(NOW + timedelta(days=1))
        .add_extension(x509.BasicConstraints(ca=name == issuer, path_length=None), critical=True)
        .sign(by, None)
    )
    return built.public_bytes(serialization.Encoding.PEM)


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A folder of keys: two authorities, and a recorder whose certificate is of the first."""
    folder = tmp_path / "keys"
    folder.mkdir()
    authority, other, recorder = (Ed25519PrivateKey.generate() for _ in range(3))
    (folder / "ca.pem").write_bytes(certificate("ca", authority, "ca", authority))
    (folder / "other.pem").write_bytes(certificate("ca", other, "ca", other))
    (folder / "recorder.pem").write_bytes(certificate("recorder", recorder, "ca", authority))
    plain = serialization.NoEncryption()
    form = serialization.PrivateFormat.PKCS8
    (folder / "ca.key").write_bytes(authority.private_bytes(serialization.Encoding.PEM, form, plain))
    (folder / "recorder.key").write_bytes(recorder.private_bytes(serialization.Encoding.PEM, form, plain))
    (folder / "stranger.key").write_bytes(other.private_bytes(serialization.Encoding.PEM, form, plain))
    (folder / "stranger.pem").write_bytes((folder / "recorder.pem").read_bytes())
    return folder


def test_who_signed_is_told(tmp_path, keys):
    path = write(tmp_path / "run.mcap", lockstep())
    assert read_signature(path, None, NOW) is None
    sign(path, load_signer(keys / "recorder.key", NOW), NOW)
    signed = read_signature(path, keys / "ca.pem", NOW)
    assert signed is not None
    assert (signed.name, signed.trusted, signed.problem) == ("recorder", True, "")
    foreign = read_signature(path, keys / "other.pem", NOW)
    assert foreign is not None
    assert (foreign.trusted, foreign.problem) == (False, "the signer's certificate is not of the trusted authority")


def test_every_changed_byte_is_found(tmp_path, keys):
    path = write(tmp_path / "run.mcap", lockstep(2))
    sign(path, load_signer(keys / "recorder.key", NOW), NOW)
    data = path.read_bytes()
    for place in (*range(0, len(data), 37), len(data) - 1):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        signed = read_signature(path, None, NOW)
        assert signed is not None
        assert signed.problem == "the file is not the one that was signed"
    path.write_bytes(data)
    signature = signature_file(path).read_bytes()
    signature_file(path).write_bytes(signature.replace(b'"signed_at":"2030', b'"signed_at":"2029'))
    signed = read_signature(path, None, NOW)
    assert signed is not None
    assert signed.problem == "the signature is not that of its key"
    signature_file(path).write_bytes(b"{" * 100_000)
    signed = read_signature(path, None, NOW)
    assert signed is not None
    assert "more than 65536 bytes" in signed.problem


def test_a_signature_of_a_time_without_a_valid_certificate_is_not_trusted(tmp_path, keys):
    path = write(tmp_path / "run.mcap", lockstep())
    late = NOW + timedelta(days=2)
    sign(path, load_signer(keys / "recorder.key", NOW), late)
    signed = read_signature(path, keys / "ca.pem", late)
    assert signed is not None
    assert "when the certificate was not valid" in signed.problem


@pytest.mark.parametrize("what", ["signature", "key", "authority"])
def test_what_is_no_regular_file_is_not_waited_for(what, tmp_path, keys):
    path = write(tmp_path / "run.mcap", lockstep())
    pipe = {"signature": signature_file(path), "key": keys / "recorder.key", "authority": keys / "ca.pem"}[what]
    pipe.unlink(missing_ok=True)
    os.mkfifo(pipe)
    if what == "signature":
        signed = read_signature(path, None, NOW)
        assert signed is not None
        assert "a pipe or a device" in signed.problem
        return
    with pytest.raises(UsageError, match="a pipe or a device"):
        load_signer(pipe, NOW) if what == "key" else read_signature(path, pipe, NOW)


def test_a_key_without_its_certificate_is_refused(keys):
    with pytest.raises(UsageError, match="another key than the certificate's"):
        load_signer(keys / "stranger.key", NOW)
    with pytest.raises(UsageError, match="there is no such certificate"):
        load_signer(keys / "nobody.key", NOW)


def test_a_key_whose_signature_nobody_would_believe_is_refused(keys):
    with pytest.raises(UsageError, match="not now; dynpf keys issue"):
        load_signer(keys / "recorder.key", NOW + timedelta(days=2))
    with pytest.raises(UsageError, match="is an authority's"):
        load_signer(keys / "ca.key", NOW)


def test_neither_a_signature_is_replaced_nor_another_file_signed(tmp_path, keys, capsys):
    path, other = write(tmp_path / "run.mcap", lockstep()), tmp_path / "notes.txt"
    other.write_text("no recording")
    words = ["--key", str(keys / "recorder.key")]
    assert main(["sign", str(path), *words]) == 0
    before = (tmp_path / "run.mcap.sig").read_bytes()
    assert main(["sign", str(path), *words]) == 2
    assert "is signed already" in capsys.readouterr().err
    assert (tmp_path / "run.mcap.sig").read_bytes() == before
    assert main(["sign", str(other), *words]) == 2
    assert not (tmp_path / "notes.txt.sig").exists()


def test_the_commands_sign_and_tell(tmp_path, keys, capsys):
    path = write(tmp_path / "run.mcap", lockstep())
    assert main(["doctor", str(path)]) == 0
    assert "not signed" in capsys.readouterr().out
    assert main(["doctor", str(path), "--trust", str(keys / "ca.pem")]) == 1
    assert "signature: the file is not signed" in capsys.readouterr().out
    assert main(["sign", str(path), "--key", str(keys / "recorder.key")]) == 0
    assert main(["doctor", str(path)]) == 0
    assert "signed by recorder, whose authority is not checked (--trust)" in capsys.readouterr().out
