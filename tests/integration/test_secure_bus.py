"""A run with keys: who has none, an old one, a revoked one or another process's sees and says nothing of it."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_protocol.control import Recorded, Stop, TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.errors import UsageError
from dynpf_protocol.keys import ALIVE, DATA, OPERATOR, READY, RECORDED, SCENARIO, STOP, TICK, data_key
from dynpf_runtime.bus.keys import Credentials, init, issue, load, revoke
from dynpf_runtime.bus.processes import free_port
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.machines.events import Arrived

from tests.integration.processes import join_bus, service_of, until, watch_run

RUN = ("landmark-room", "--set", "max_ticks=200")


def digest(path: Path) -> str:
    return content_digest(read_recording(path))


@pytest.fixture(name="inline", scope="module")
def digest_of_the_run_without_a_bus(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("inline") / "run.mcap"
    assert main(["run", *RUN, "--runner", "inline", "-o", str(path)]) == 0
    return digest(path)


def forge(bus: Bus, boots: dict[str, str], controller: str = "controller") -> None:
    """Say all that could stall, end or change a run, with true boots."""
    for node, boot in boots.items():
        place = Envelope(node, boot, 10**6, 1, 0, 0)
        bus.put(f"{DATA}controller/command", b'{"v": 1.0, "omega": 0.0}', encode_envelope(place))
        bus.put(f"{DATA}truth/robot", b"{}", encode_envelope(place))
        bus.put(data_key("log", node), b"{}", encode_envelope(place))
        bus.put(f"{TICK}{node}", encode_control(TickDone(node, boot, 10**6, 10**6, 0, {}, True)))
        bus.put(f"{STOP}{node}", encode_control(Stop(node, boot, "forged")))
        bus.put(RECORDED, encode_control(Recorded(boot, True, "forged", "other.mcap")))
        bus.declare(f"{ALIVE}{node}/forged")
        bus.declare(f"{READY}{node}/forged")


def test_with_the_key_of_a_node_nobody_speaks_in_the_name_of_another(tmp_path, dynpf, here, inline):
    path = tmp_path / "run.mcap"
    run = dynpf("run", *RUN, "-o", path)
    with watch_run(tmp_path, run) as watched:
        watched.await_ticks(20)
        process = until(lambda: service_of(tmp_path, "sensors"), "its process")
        assert process is not None
        boots = {name: watched.boot(name) for name in ("simulator", "estimator", "controller", "recorder", "router")}
        own = process.credentials("sensors")
        with join_bus(process.endpoint, own) as mouth, join_bus(process.endpoint, own) as ears:
            for key in (f"{DATA}**", f"{TICK}**", f"{DATA}controller/command", f"{DATA}truth/robot"):
                ears.subscribe(key)
            forge(mouth, boots)
            watched.await_ticks(20)
            heard = {one.key for one in (until(lambda: ears.receive(0.1), "a message") for _ in range(20)) if one}
            assert heard == {f"{DATA}truth/robot"}, "it hears what a node of its name reads"
        for name in boots:
            (_,) = watched.bus.tokens(f"{ALIVE}{name}/*")
    assert run.wait() == 0, run.stderr
    assert digest(path) == inline
    assert "refused" not in run.stderr


def test_the_same_words_on_a_bus_without_keys_are_heard_by_all(tmp_path, dynpf):
    """The control of the test before this one."""
    run = dynpf("run", *RUN, "--insecure", "-o", tmp_path / "run.mcap")
    with watch_run(tmp_path, run) as watched:
        watched.await_ticks(20)
        boots = {"controller": watched.boot("controller")}
        with join_bus(watched.endpoint) as ears:
            ears.subscribe(RECORDED)
            forge(watched.bus, boots)
            heard = until(lambda: ears.receive(0.1), "a forged message")
            assert isinstance(heard, Arrived)
            assert heard.key == RECORDED
    run.interrupt()
    run.says("again to end it at once")
    run.interrupt()
    run.wait()


def test_an_observer_hears_all_and_says_nothing_and_an_operator_may_stop_the_run(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--set", "rate=40", "-o", path)  # slower than an operator on a busy machine
    with watch_run(tmp_path, run) as watched:
        watched.bus.subscribe(f"{DATA}**")
        watched.await_ticks(20)
        boot = watched.boot("controller")
        watched.bus.put(f"{STOP}observer", encode_control(Stop("observer", "mine", "by the observer")))
        watched.bus.put(f"{STOP}controller", encode_control(Stop("controller", boot, "by the observer")))
        watched.await_ticks(20)
        process = until(lambda: service_of(tmp_path, "sensors"), "its process")
        assert process is not None
        operator = process.credentials(OPERATOR)
        assert operator is not None
        keys = ["--keys", operator.folder]
        assert f"observer and operator: --connect {process.endpoint} --keys {keys[1]}\n" in run.stderr
        stop = here("stop", "--connect", process.endpoint, *keys, "--reason", "by the operator")
        assert stop.out == "the run has ended, and its recording is complete\n", stop.err
        assert run.wait() == 0, run.stderr
    assert "complete: by the operator" in run.stdout
    assert here("replay", path).code == 0
    assert not list(tmp_path.glob("dynpf-*"))


def test_the_keys_of_guests_lie_where_they_are_wanted_as_long_as_the_run(tmp_path, dynpf, here):
    guests = tmp_path / "mine"
    run = dynpf("run", "landmark-room", "--keys", guests, "-o", tmp_path / "run.mcap")
    until((guests / "operator.pem").exists, "the operator's certificate")
    assert sorted(path.name for path in guests.glob("*.key")) == ["observer.key", "operator.key"]
    assert not list(tmp_path.rglob("ca.key"))
    refused = here("run", "landmark-room", "--keys", guests, "-o", tmp_path / "other.mcap")
    assert (refused.code, "has keys already" in refused.err) == (2, True)
    assert load(guests, "observer", datetime.now(UTC)).name == "observer", "the refusal has taken nothing away"
    run.interrupt()
    assert run.wait() in (0, 1)
    assert list(guests.iterdir()) == []


@contextmanager
def knocking(endpoint: str, keys: Credentials | None) -> Iterator[Bus]:
    began = time.monotonic()
    with Bus.connect(endpoint, lambda _: None, lambda: time.monotonic() - began > 20.0, keys) as bus:
        yield bus


def test_a_router_takes_nobody_without_a_key_of_its_authority_and_says_whom_it_refused(tmp_path, dynpf, here):
    now, keys, other = datetime.now(UTC), tmp_path / "keys", tmp_path / "other"
    init(keys, now)
    init(other, now)
    words = ("landmark-room", "--set", "max_ticks=20")
    issue(keys, ["router", "recorder", "simulator", "sensors", "estimator", "controller", "observer", "vision"], now)
    issue(other, ["sensors", "router"], now)
    old = tmp_path / "old"
    endpoint = f"tls/127.0.0.1:{free_port()}"
    router = dynpf("service", "router", *words, "--listen", endpoint, "--keys", keys)
    router.says(f"listening at {endpoint}")
    assert "the certificate" in router.stderr and "expires on" in router.stderr
    assert here("health", "router", "--connect", endpoint, "--keys", keys).code == 0

    plain = endpoint.replace("tls", "tcp")
    refused = here("health", "router", "--connect", plain, "--timeout", "5")
    assert "takes only processes that have a key: give --keys FOLDER" in refused.err
    foreign = load(other, "sensors", now)
    with (
        pytest.raises(UsageError, match=r"shows a certificate that .* does not vouch for"),
        knocking(endpoint, foreign),
    ):
        pass
    # It believes the router, but has a certificate that another authority has signed.
    posing = foreign._replace(authority=keys / "ca.pem")
    with pytest.raises(UsageError, match="refuses the certificate"), knocking(endpoint, posing):
        pass
    expired = with_expired_key(keys, old)
    with pytest.raises(UsageError, match=r"refuses the certificate .*expired"), knocking(endpoint, expired):
        pass
    for text in (
        "it spoke no TLS",
        "it showed no certificate",
        "its certificate is not of",
        "its certificate has expired",
    ):
        router.says(f"a connection was refused: {text}")
    assert "Hint" not in router.stderr

    # Vision has a certificate of the authority, but no part in this run.
    with knocking(endpoint, load(keys, "vision", now)) as bus:
        assert bus.ask(SCENARIO) is None
        assert bus.tokens(f"{ALIVE}**") == []
        router.says("has a certificate of the name 'vision', which is revoked or takes no part in this run")
    with knocking(endpoint, load(keys, "observer", now)) as bus:  # the control
        assert bus.ask(SCENARIO) is not None
        assert len(bus.tokens(f"{ALIVE}**")) == 1
    router.interrupt()
    assert router.wait() == 1


def with_expired_key(keys: Path, folder: Path) -> Credentials:
    """Return credentials of sensors that were good until a second ago."""
    folder.mkdir(mode=0o700)
    for name in ("ca.pem", "ca.key"):
        (folder / name).write_bytes((keys / name).read_bytes())
    now = datetime.now(UTC)
    issue(folder, ["sensors"], now, days=-1 / 86400)
    return load(folder, "sensors", now - timedelta(minutes=1))


def test_a_revoked_key_has_no_access_from_the_routers_next_start_on(tmp_path, dynpf, here):
    now, keys, path = datetime.now(UTC), tmp_path / "keys", tmp_path / "run.mcap"
    init(keys, now)
    names = ("router", "recorder", "simulator", "sensors", "estimator", "controller")
    issue(keys, [*names, "observer"], now)
    stolen = tmp_path / "stolen"
    stolen.mkdir(mode=0o700)
    for name in ("ca.pem", "sensors.pem", "sensors.key"):
        (stolen / name).write_bytes((keys / name).read_bytes())
    revoke(keys, "sensors")
    issue(keys, ["sensors"], now)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    words = ("landmark-room", "--set", "max_ticks=20")
    router = dynpf("service", "router", *words, "--listen", endpoint, "--keys", keys)
    router.says("revoked certificates get no access: sensors")
    thief = dynpf("service", "sensors", *words, "--connect", endpoint, "--keys", stolen)
    assert thief.wait() == 1
    assert (
        "does not say which scenario it runs; is it a dynpf router, and is sensors's key not revoked?" in thief.stderr
    )
    router.says("has a certificate of the name 'sensors', which is revoked")
    rest = [
        dynpf(
            "service",
            name,
            *words,
            "--connect",
            endpoint,
            "--keys",
            keys,
            *(["-o", path] if name == "recorder" else []),
        )
        for name in names[1:]
    ]
    assert [one.wait() for one in (router, *rest)] == [0] * 6, [one.stderr for one in rest]
    assert here("doctor", path).code == 0
