"""The peers do the work that they are measured at."""

from collections.abc import Iterator

import numpy as np
import pytest
from dynpf_lab.bench.peers import PEERS, PEERS_PYTHON, Peers
from dynpf_lab.bench.problems import LandmarkProblem
from dynpf_protocol.errors import RunError

pytestmark = pytest.mark.skipif(not PEERS_PYTHON.exists(), reason="no other libraries here: make peers")


@pytest.fixture(scope="module")
def peers() -> Iterator[Peers]:
    with Peers() as started:
        yield started


def test_every_library_tracks_the_robot_for_a_lap(peers: Peers) -> None:
    assert [peer.name for peer in peers.all] == list(PEERS)
    problem = LandmarkProblem()
    for peer in peers.all:
        peer.prepare(problem, 500)
        for _ in range(4):
            assert peer.seconds(10) > 0.0  # raises where the robot is lost
        assert peer.version


def test_a_filter_that_loses_the_robot_is_not_measured(peers: Peers) -> None:
    problem = LandmarkProblem()
    problem.start = problem.start + np.array([3.0, 0.0, 1.0])
    peers.all[0].prepare(problem, 500)
    with pytest.raises(RunError, match=r"particles is .* m off the truth"):
        peers.all[0].seconds(1)


def test_what_a_library_cannot_do_is_an_error_with_its_traceback(peers: Peers) -> None:
    with pytest.raises(RunError, match="filterpy: Traceback"):
        peers.all[-1].prepare(LandmarkProblem(), -1)
    peers.all[-1].prepare(LandmarkProblem(), 10)
    assert peers.all[-1].seconds(1) > 0.0
