"""Other libraries at the landmark problem: one long-lived process each, in the peers' environment."""

import json
import os
import subprocess
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from dynpf_protocol.errors import RunError

from dynpf_lab.bench.problems import LandmarkProblem

__all__ = ["PEERS", "PEERS_PYTHON", "Peer", "Peers"]

PEERS = ("particles", "pfilter", "stonesoup", "filterpy")
PEERS_PYTHON = Path(__file__).parents[3] / ".venv-peers" / "bin" / "python"
"""Made by ``make peers`` in a checkout."""

LOST_M = 0.5
"""Greatest error of a peer's estimate; a filter with a greater error does not do the measured work."""

_WORKER = Path(__file__).with_name("peer_worker.py")
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Peer:
    """The process of one library."""

    def __init__(self, name: str, python: Path) -> None:
        self.name = name
        self.version = ""
        self._process = subprocess.Popen(
            [str(python), "-I", str(_WORKER), name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **_ONE_THREAD},
            start_new_session=True,  # Ctrl-C reaches this process only, which then ends the peer
        )

    def prepare(self, problem: LandmarkProblem, n: int) -> None:
        """Make a filter of ``n`` particles and start it; raises RunError when the library cannot."""
        self.version = self._ask("prepare", problem=problem.as_request(), n=n, seed=0)["version"]
        self._truth = problem.truth

    def seconds(self, updates: int) -> float:
        """Return the seconds that the updates took; raises RunError if the filter has lost the robot."""
        answer = self._ask("run", updates=updates)
        off = float(np.hypot(*(np.array(answer["estimate"]) - self._truth[answer["step"]])[:2]))
        if not off < LOST_M:
            raise RunError(f"{self.name} is {off:.2f} m off the truth: it does not track, so its time is no comparison")
        return float(answer["seconds"])

    def release(self) -> None:
        """Release the filter and its memory."""
        self._ask("release")

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()

    def _ask(self, command: str, **what: Any) -> dict[str, Any]:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            print(json.dumps({"command": command, **what}), file=self._process.stdin, flush=True)
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise RunError(f"{self.name}: its process has ended; make peers creates its environment again")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise RunError(f"{self.name}: {answer['error'].strip()}")
        return answer


class Peers(AbstractContextManager["Peers"]):
    """All installed libraries; their processes end on leaving the context."""

    def __init__(self, names: Sequence[str] = PEERS, python: Path = PEERS_PYTHON) -> None:
        self.all: list[Peer] = []
        if python.exists():
            self.all = [Peer(name, python) for name in names]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for peer in self.all:
            peer.close()
