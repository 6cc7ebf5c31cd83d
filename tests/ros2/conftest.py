"""The other side of all tests here, and no test without it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from dynpf_formats.ros2.types import RosTypes
from dynpf_runtime.bus.processes import free_port

from tests.integration.conftest import run_here, start_dynpf  # noqa: F401  as fixtures
from tests.integration.robots import router
from tests.ros2.oracle import PYTHON, Oracle, oracle_in


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    absent = pytest.mark.skip(reason="no packages of ROS 2 here: make ros2")
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.ros2)
            if not PYTHON.exists():
                item.add_marker(absent)


@pytest.fixture(scope="session")
def types() -> RosTypes:
    return RosTypes()


@pytest.fixture(scope="session")
def port() -> Iterator[int]:
    """The port of a robot's router."""
    port = free_port()
    with router(f"tcp/127.0.0.1:{port}"):
        yield port


@pytest.fixture(scope="session")
def endpoint(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory, port: int) -> Iterator[Oracle]:
    """The other side, which has joined the robot's router."""
    with oracle_in(tmp_path_factory.mktemp("other")) as oracle:
        oracle.ask("join", port=port)
        yield oracle
