"""The process of the other side, which knows nothing of dynpf."""

import dataclasses
import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

__all__ = ["PYTHON", "Oracle", "oracle_in", "plain"]

PYTHON = Path(__file__).parents[2] / ".venv-ros2" / "bin" / "python"
"""Made by ``make ros2``."""


class Oracle:
    """Asks the other side; its functions are those of other_side.py."""

    def __init__(self, folder: Path) -> None:
        home = {**os.environ, "HOME": str(folder), "ROS_LOG_DIR": str(folder)}
        home["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        script = Path(__file__).with_name("other_side.py")
        self._process = subprocess.Popen(
            [str(PYTHON), "-I", "-W", "ignore", str(script), str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=home,
        )

    def ask(self, question: str, **what: Any) -> Any:
        """Return the answer; fails the test with the other side's traceback."""
        assert self._process.stdin is not None and self._process.stdout is not None
        print(json.dumps({"ask": question, **what}), file=self._process.stdin, flush=True)
        answer = json.loads(self._process.stdout.readline())
        assert "error" not in answer, answer["error"]
        return answer["answer"]

    def close(self) -> None:
        """End the process, which has nothing to lose."""
        self._process.kill()
        self._process.communicate()


@contextmanager
def oracle_in(folder: Path) -> Iterator[Oracle]:
    """Start the other side; its home is ``folder``."""
    oracle = Oracle(folder)
    try:
        yield oracle
    finally:
        oracle.close()


def plain(value: Any) -> Any:
    """Return a message as the other side tells it."""
    if dataclasses.is_dataclass(value):
        names = (field.name for field in dataclasses.fields(value))
        return {name: plain(getattr(value, name)) for name in names if name[0].islower()}  # constants are capitals
    if isinstance(value, str):
        return value
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(one) for one in value] if hasattr(value, "__len__") else value
