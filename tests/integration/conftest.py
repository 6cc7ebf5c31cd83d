"""What every test with processes shares: starting them, and the proof that none is left."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from dynpf_lab.cli.main import main

from tests.integration.processes import DATA, Child, processes_of, start, until

Start = Callable[..., Child]


class Told(NamedTuple):
    """What a command that ran in this process said."""

    code: int
    out: str
    err: str


@pytest.fixture(name="dynpf")
def start_dynpf(tmp_path: Path) -> Iterator[Start]:
    """Start dynpf processes; when the test is over, all must have ended by themselves, their own children too."""
    children: list[Child] = []

    def started(*words: object, most_bytes: int | None = None, modules: Path | None = None) -> Child:
        children.append(start(tmp_path, *words, most_bytes=most_bytes, modules=modules))
        return children[-1]

    try:
        yield started
        until(lambda: all(child.popen.poll() is not None for child in children), "the end of every process", 10.0)
        until(lambda: not processes_of(tmp_path), "the end of every process that those started", 10.0)
    finally:
        for left in processes_of(tmp_path):
            with contextlib.suppress(ProcessLookupError):
                os.kill(left.pid, signal.SIGKILL)
        for child in children:
            if child.popen.poll() is None:
                child.popen.kill()
            child.popen.wait()


@pytest.fixture(name="here")
def run_here(capsys: pytest.CaptureFixture[str]) -> Callable[..., Told]:
    """Run a command in this very process, where starting another would only cost time."""

    def run(*words: object) -> Told:
        capsys.readouterr()
        code = main([str(word) for word in words])
        return Told(code, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of a real robot's log, imported."""
    source = DATA / "mrclam" / "ds1_seed_60s"
    if not source.is_dir():
        pytest.skip(f"the log {source} is not here")
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    assert main(["import", "mrclam", str(source), "-o", str(path)]) == 0
    return path
