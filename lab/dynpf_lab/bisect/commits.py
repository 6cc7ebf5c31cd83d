"""The commit that made the replay of a recording differ, by git bisect in a worktree of its own."""

import json
import os
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from dynpf_protocol.errors import UsageError
from dynpf_runtime.progress import show_progress

from dynpf_lab.bisect.environments import LOCK, environment, search_path

__all__ = ["Commit", "Replay", "Tried", "first_bad"]

_FOUND = re.compile(r"^([0-9a-f]{40,64}) is the first bad commit", re.MULTILINE)
_LEFT = re.compile(r"^([0-9a-f]{40,64})$", re.MULTILINE)


class Tried(NamedTuple):
    """What came of a replay: ``skip`` if the commit cannot replay the recording at all, and ``note`` says why.

    ``first`` is the first difference as ``dynpf replay --json`` tells it.
    """

    verdict: Literal["good", "bad", "skip"]
    first: dict[str, Any] | None = None
    note: str = ""


class Commit(NamedTuple):
    """A commit, whether its lock differs from that of the commit before, and what came of the replay."""

    revision: str
    date: str
    subject: str
    changes_lock: bool
    tried: Tried


@dataclass(frozen=True)
class Replay:
    """The recording to be replayed, with the words for the replay, folders of code in the repository, and the cache."""

    recording: Path
    words: tuple[str, ...]
    code: tuple[Path, ...]
    cache: Path

    def __call__(self, worktree: Path) -> Tried:
        """Replay the recording by the code of a worktree, in the environment of its lock."""
        python = environment(worktree, self.cache)
        command = [str(python), "-m", "dynpf_lab.cli.main", "replay", str(self.recording.absolute()), "--json"]
        for folder in self.code:
            command += ["--code", str(worktree / folder)]
        own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        if packages := search_path(worktree):
            own |= {"PYTHONPATH": os.pathsep.join(packages), "NUMBA_CACHE_DIR": str(worktree.parent / "kernels")}
        # Bytecode is known by the second and size of its source, which git may write several times in a second.
        own["PYTHONDONTWRITEBYTECODE"] = "1"
        done = subprocess.run(
            [*command, *self.words], cwd=worktree, env=own, capture_output=True, text=True, check=False
        )
        return _read(done)


def _read(done: "subprocess.CompletedProcess[str]") -> Tried:
    try:
        told = json.loads(done.stdout)
        same, first = bool(told["same"]), told["first"]
    except (ValueError, TypeError, KeyError):
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return Tried("skip", note=lines[-1])
    return Tried("good" if same else "bad", first)


def first_bad(
    repository: Path, good: str | None, bad: str, replay: Callable[[Path], Tried]
) -> tuple[Commit | None, tuple[str, ...]]:
    """Return the first commit from ``good`` to ``bad`` whose replay differs, or None and those of which it is one.

    Without ``good`` the commits 1, 2, 4 and so on before ``bad`` are tried for one. The checkout itself stays as it is.
    Raises UsageError for a revision that is none, where the replay by ``good`` differs, and where that by ``bad`` does
    not.
    """
    last = _revision(repository, bad)
    if good is not None and _revision(repository, good) == last:
        raise UsageError(f"--good {good}, --bad {bad}: are one commit, {last[:12]}")
    tried: dict[str, Tried] = {}
    with _worktree(repository) as worktree:

        def attempt(revision: str) -> Tried:
            show_progress(f"replay by {revision[:12]}, {len(tried) + 1}")
            _git(worktree, "checkout", "--quiet", "--detach", revision)
            tried[revision] = replay(worktree)
            return tried[revision]

        _check(bad, "bad", attempt(last))
        if good is None:
            begin = _earlier(repository, bad, attempt)
        else:
            begin = _revision(repository, good)
            _check(good, "good", attempt(begin))
        told, revision = _git(worktree, "bisect", "start", last, begin, "--"), ""
        while (found := _FOUND.search(told)) is None and "'skip'ped" not in told:
            before, revision = revision, _revision(worktree, "HEAD")
            if revision == before:
                raise UsageError(f"{repository}: git bisect cannot go on: {told}")
            told = _git(worktree, "bisect", (tried.get(revision) or attempt(revision)).verdict, may_fail=True)
        show_progress("")
        if found is None:
            return None, tuple(revision[:12] for revision in _LEFT.findall(told))
        return _described(repository, found[1], tried[found[1]]), ()


def _earlier(repository: Path, bad: str, attempt: Callable[[str], Tried]) -> str:
    """Return a commit before ``bad`` whose replay is the same; raises UsageError if none of those tried is one."""
    distance = 1
    while True:
        try:
            revision = _revision(repository, f"{bad}~{distance}")
        except UsageError:
            raise UsageError(
                f"no commit that is 1, 2, 4 and so on before {bad} replays the recording as it is; name one that does "
                "with --good REV"
            ) from None
        if attempt(revision).verdict == "good":
            return revision
        distance *= 2


def _revision(repository: Path, name: str) -> str:
    return _git(repository, "rev-parse", "--verify", f"{name}^{{commit}}")


def _check(name: str, wanted: str, tried: Tried) -> None:
    if tried.verdict == wanted:
        return
    if tried.verdict == "skip":
        raise UsageError(f"{name}: cannot replay the recording: {tried.note}")
    if wanted == "good":
        raise UsageError(f"{name}: its replay differs already; name an earlier commit with --good")
    raise UsageError(f"{name}: its replay is the same; name a commit whose replay differs with --bad")


def _described(repository: Path, revision: str, tried: Tried) -> Commit:
    date, subject = _git(repository, "show", "--no-patch", "--format=%as%n%s", revision).split("\n", 1)
    changed = _git(repository, "diff-tree", "--no-commit-id", "--name-only", "-r", revision).splitlines()
    return Commit(revision, date, subject, LOCK in changed, tried)


@contextmanager
def _worktree(repository: Path) -> Iterator[Path]:
    """Give a worktree of its own, which has its own state of git bisect, and remove it afterwards."""
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        worktree = Path(folder) / "tree"
        _git(repository, "worktree", "add", "--quiet", "--detach", str(worktree), "HEAD")
        try:
            yield worktree
        finally:
            _git(repository, "worktree", "remove", "--force", str(worktree))


def _git(folder: Path, *words: str, may_fail: bool = False) -> str:
    """Return what git prints; raises UsageError with git's own words if it fails."""
    command: Sequence[str] = ("git", "-C", str(folder), *words)
    own = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=own)
    except FileNotFoundError:
        raise UsageError("git is not installed; it is needed to find a commit") from None
    if done.returncode and not may_fail:
        raise UsageError(f"{folder}: git {words[0]} failed: {done.stderr.strip()}")
    return f"{done.stdout}{done.stderr if may_fail else ''}".strip()
