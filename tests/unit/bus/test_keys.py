"""Folders of keys: who is believed, until when, and what is said of those that will not do."""

import base64
import contextlib
import ssl
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from dynpf_formats.recording.signature import load_signer
from dynpf_protocol.errors import UsageError
from dynpf_runtime.bus.keys import current_name, init, issue, issued, load, revoke, revoked, run_keys

NOW = datetime(2026, 5, 4, 12, tzinfo=UTC)
DAY = timedelta(days=1)


@pytest.fixture(name="folder")
def folder_with_an_authority(tmp_path: Path) -> Path:
    init(tmp_path / "keys", NOW)
    return tmp_path / "keys"


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def test_nobody_else_may_read_the_keys(folder: Path) -> None:
    issue(folder, ["router", "r1/estimator"], NOW)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    files = sorted(path.name for path in folder.iterdir())
    stems = ("ca", "router", "r1.estimator")
    assert files == sorted([*(f"{stem}.{kind}" for stem in stems for kind in ("pem", "key")), "revoked"])
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.glob("*.key")} == {0o600}
    assert isinstance(load_pem_private_key((folder / "router.key").read_bytes(), None), Ed25519PrivateKey)


def test_a_container_s_user_can_read_the_key_that_it_is_given_but_not_open_the_folder(folder: Path) -> None:
    issue(folder, ["vision"], NOW, for_containers=True)
    assert stat.S_IMODE((folder / "vision.key").stat().st_mode) == 0o444
    assert stat.S_IMODE((folder / "ca.key").stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.parametrize(
    ("of_folder", "of_key", "private"), [(0o755, 0o644, False), (0o700, 0o444, True), (0o755, 0o600, True)]
)
def test_a_key_that_others_can_read_is_refused(folder: Path, of_folder: int, of_key: int, private: bool) -> None:
    issue(folder, ["vision"], NOW)
    folder.chmod(of_folder)
    (folder / "vision.key").chmod(of_key)
    if private:
        assert load(folder, "vision", NOW).name == "vision"
    else:
        with pytest.raises(UsageError, match=r"vision\.key: others can read it"):
            load(folder, "vision", NOW)


def test_a_folder_that_others_may_open_is_refused(tmp_path: Path) -> None:
    (tmp_path / "open").mkdir(mode=0o755)
    with pytest.raises(UsageError, match="others may open it"):
        init(tmp_path / "open", NOW)


def test_an_authority_is_not_replaced(folder: Path) -> None:
    before = (folder / "ca.pem").read_bytes()
    with pytest.raises(UsageError, match="has a certificate authority already"):
        init(folder, NOW)
    with pytest.raises(UsageError, match="has keys already"), run_keys({folder: ["observer"]}, NOW):
        pass
    assert (folder / "ca.pem").read_bytes() == before


def handshake(folder: Path, server: str, client: str, host: str) -> None:
    """Let OpenSSL shake hands, in memory; raises ssl.SSLError if one side does not believe the other."""
    sides = {}
    for name, purpose in ((server, ssl.PROTOCOL_TLS_SERVER), (client, ssl.PROTOCOL_TLS_CLIENT)):
        context = ssl.SSLContext(purpose)
        context.verify_mode = ssl.CERT_REQUIRED
        context.verify_flags |= ssl.VERIFY_X509_STRICT
        context.load_verify_locations(folder / "ca.pem")
        context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
        sides[purpose] = context
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        sides[ssl.PROTOCOL_TLS_CLIENT].wrap_bio(down, up, server_hostname=host),
        sides[ssl.PROTOCOL_TLS_SERVER].wrap_bio(up, down, server_side=True),
    ]
    for end in ends * 2:
        with contextlib.suppress(ssl.SSLWantReadError):
            end.do_handshake()
    assert [end.version() for end in ends] == ["TLSv1.3"] * 2


def test_openssl_believes_the_router_under_its_names_and_no_node_in_its_place(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    init(folder, datetime.now(UTC))
    issue(folder, ["router", "vision"], datetime.now(UTC), hosts=("robot.local", "10.0.0.7"))
    for host in ("robot.local", "10.0.0.7"):
        handshake(folder, "router", "vision", host)
    for host in ("localhost", "10.0.0.8"):
        with pytest.raises(ssl.SSLCertVerificationError, match="mismatch"):
            handshake(folder, "router", "vision", host)
    issue(folder, ["router"], datetime.now(UTC))
    handshake(folder, "router", "vision", "127.0.0.1")
    with pytest.raises(ssl.SSLError):
        handshake(folder, "vision", "vision", "127.0.0.1")


def test_a_certificate_holds_for_days_and_no_longer_than_its_authority(folder: Path) -> None:
    (short,) = issue(folder, ["vision"], NOW, days=2)
    assert short.expires == NOW + 2 * DAY
    assert load(folder, "vision", NOW + 1.9 * DAY).expires == short.expires
    with pytest.raises(UsageError, match=r"vision\.pem: expired on 2026-05-06 12:00 UTC; renew .*keys issue vision"):
        load(folder, "vision", NOW + 2.1 * DAY)
    with pytest.raises(UsageError, match=r"ca\.pem: holds only from 2026-05-04 11:55 UTC on; is the clock here"):
        load(folder, "vision", NOW - 0.1 * DAY)
    (long,) = issue(folder, ["vision"], NOW, days=1000)
    assert long.expires == certificate(folder / "ca.pem").not_valid_after_utc == NOW + 365 * DAY
    with pytest.raises(UsageError, match=r"ca\.pem: expired on"):
        issue(folder, ["vision"], NOW + 366 * DAY)


def test_what_will_not_do_is_told(folder: Path, tmp_path: Path) -> None:
    issue(folder, ["vision", "sensors"], NOW)
    with pytest.raises(UsageError, match=r"estimator\.pem: there is no such file; .*dynpf keys issue estimator"):
        load(folder, "estimator", NOW)
    with pytest.raises(UsageError, match="there is no such certificate"):
        load(tmp_path / "nowhere", "vision", NOW)
    for kind in ("pem", "key"):
        (folder / f"vision.{kind}").rename(folder / f"estimator.{kind}")
    with pytest.raises(UsageError, match="is the certificate of vision, not of estimator"):
        load(folder, "estimator", NOW)
    (folder / "sensors.key").write_bytes((folder / "estimator.key").read_bytes())
    with pytest.raises(UsageError, match="it is another key than the certificate"):
        load(folder, "sensors", NOW)
    for broken in (b"", b"\xff\x00", (folder / "ca.pem").read_bytes()):
        (folder / "sensors.key").write_bytes(broken)
        with pytest.raises(UsageError, match=r"sensors\.key: no key of .* can be read from it"):
            load(folder, "sensors", NOW)
    init(tmp_path / "other", NOW)
    (folder / "ca.pem").write_bytes((tmp_path / "other" / "ca.pem").read_bytes())
    with pytest.raises(UsageError, match="is not of the authority in"):
        load(folder, "estimator", NOW)


@pytest.mark.parametrize("name", ["", "ca", "../vision", "/etc/vision", "Vision", "vision@1", "a b", "a" * 65])
def test_no_key_is_issued_under_a_name_that_no_process_has(name: str, folder: Path) -> None:
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(UsageError, match=r"no process can have keys|no certificate can have this name"):
        issue(folder, [name], NOW)
    assert sorted(folder.parent.rglob("*")) == before


def private_key(content: bytes) -> bytes:
    """Return a private key in PEM; one of ed25519 has 32 bytes of content."""
    inner = b"\x04" + bytes([len(content)]) + content
    body = bytes.fromhex("020100300506032b6570") + b"\x04" + bytes([len(inner)]) + inner
    der = base64.encodebytes(b"\x30" + bytes([len(body)]) + body)
    return b"-----BEGIN PRIVATE KEY-----\n" + der + b"-----END PRIVATE KEY-----\n"


@pytest.mark.parametrize("key", [private_key(bytes(31)), private_key(bytes(32)), b"", b"\0"])
def test_a_broken_key_is_told_in_a_line(key: bytes, folder: Path) -> None:
    issue(folder, ["estimator"], NOW)
    (folder / "estimator.key").write_bytes(key)
    with pytest.raises(UsageError, match=r"estimator\.key: no key of .*estimator\.pem can be read from it: .") as told:
        load(folder, "estimator", NOW)
    assert "\n" not in str(told.value)
    with pytest.raises(UsageError, match=r"estimator\.key") as told:
        load_signer(folder / "estimator.key", NOW)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("names", [[], ["estimator", "router"]], ids=["no name", "two names"])
def test_a_certificate_says_once_whose_it_is(names: list[str], folder: Path) -> None:
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name) for name in names])
    key = Ed25519PrivateKey.generate()
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(subject).public_key(key.public_key())
    builder = builder.serial_number(1).not_valid_before(NOW).not_valid_after(NOW + timedelta(days=1))
    (folder / "x.pem").write_bytes(builder.sign(key, None).public_bytes(serialization.Encoding.PEM))
    with pytest.raises(UsageError, match=r"x\.pem: no certificate can be read from it: it does not say, once, whose"):
        issued(folder)


def test_a_revoked_name_is_followed_by_another(folder: Path) -> None:
    issue(folder, ["vision"], NOW)
    assert revoke(folder, "vision") == ("vision", [folder / "vision.pem", folder / "vision.key"])
    with pytest.raises(UsageError, match=r"vision\.pem: there is no such file"):
        load(folder, "vision", NOW)
    (new,) = issue(folder, ["vision"], NOW)
    assert new.common_name == "vision@1" == current_name("vision", revoked(folder))
    assert load(folder, "vision", NOW).name == "vision"
    assert revoke(folder, "vision")[0] == "vision@1"
    assert revoked(folder) == ("vision", "vision@1")
    assert current_name("sensors", revoked(folder)) == "sensors"


def test_the_keys_of_a_run_end_with_it_and_its_authority_signs_nothing_more(tmp_path: Path) -> None:
    own, guests = tmp_path / "own", tmp_path / "guests"
    with run_keys({own: ("router", "a"), guests: ("observer",)}, NOW):
        assert not [*tmp_path.rglob("ca.key")]
        assert {load(own, "a", NOW).name, load(guests, "observer", NOW).name} == {"a", "observer"}
        assert (own / "ca.pem").read_bytes() == (guests / "ca.pem").read_bytes()
        assert [one.common_name for one in issued(guests)][1:] == ["observer"]
    assert [*own.iterdir(), *guests.iterdir()] == []


def test_a_certificate_of_another_version_is_told(folder: Path) -> None:
    issue(folder, ["router"], NOW)
    path = folder / "router.pem"
    der = certificate(path).public_bytes(serialization.Encoding.DER)
    version = der.index(b"\xa0\x03\x02\x01\x02") + 4
    text = base64.encodebytes(der[:version] + b"\x12" + der[version + 1 :]).decode()
    path.write_text(f"-----BEGIN CERTIFICATE-----\n{text}-----END CERTIFICATE-----\n")
    with pytest.raises(UsageError, match=r"router\.pem: no certificate can be read from it"):
        load(folder, "router", NOW)
