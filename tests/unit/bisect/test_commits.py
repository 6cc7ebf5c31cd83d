"""The commit that made a replay differ is found in a repository, whose checkout stays as it is."""

import subprocess
import sys
from pathlib import Path

import pytest
from dynpf_lab.bisect.commits import Tried, first_bad
from dynpf_lab.bisect.environments import LOCK, environment, search_path
from dynpf_protocol.errors import RunError, UsageError

HERE = Path(__file__).parents[3]


def git(folder: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", str(folder), *words], check=True, capture_output=True, text=True).stdout


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    folder = tmp_path / "repository"
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    git(folder, "config", "user.name", "me")
    git(folder, "config", "user.email", "me@example.org")
    for number, word in enumerate(["good", "good", "good", "skip", "good", "bad", "bad", "bad"]):
        (folder / "word").write_text(f"{word} {number}")
        (folder / LOCK).write_text("a==2\n" if number >= 5 else "a==1\n")
        git(folder, "add", ".")
        git(folder, "commit", "--quiet", "-m", f"Commit {number}: {word}")
    (folder / "word").write_text("not committed")
    return folder


def replay(worktree: Path) -> Tried:
    word = (worktree / "word").read_text().split()[0]
    return Tried(word, {"tick": 3} if word == "bad" else None, "does not start")  # type: ignore[arg-type]


def test_the_first_commit_whose_replay_differs_is_found(repository):
    found, left = first_bad(repository, "HEAD~7", "HEAD", replay)
    assert found is not None
    assert (found.subject, found.changes_lock, found.tried.first) == ("Commit 5: bad", True, {"tick": 3})
    assert left == ()
    assert (repository / "word").read_text() == "not committed"
    assert len(git(repository, "worktree", "list").splitlines()) == 1


def test_a_commit_to_begin_with_is_looked_for_in_ever_larger_steps(repository):
    found, _ = first_bad(repository, None, "HEAD~1", replay)  # 5 is bad, 4 good
    assert found is not None
    assert found.subject == "Commit 5: bad"
    with pytest.raises(UsageError, match="no commit that is 1, 2, 4 and so on before HEAD"):
        first_bad(repository, None, "HEAD", lambda _: Tried("bad"))


def test_commits_that_cannot_replay_at_all_are_passed_over_and_told(repository):
    def broken(worktree: Path) -> Tried:
        tried = replay(worktree)
        return Tried("skip") if (worktree / "word").read_text().startswith(("good 4", "bad 5")) else tried

    found, left = first_bad(repository, "HEAD~6", "HEAD", broken)
    assert found is None
    # With 3 and 4 the first bad one is 5 or 6: nobody can say which.
    subjects = {git(repository, "show", "--no-patch", "--format=%s", one).strip() for one in left}
    assert {"Commit 5: bad", "Commit 6: bad"} <= subjects


@pytest.mark.parametrize(
    ("good", "bad", "told"),
    [
        ("HEAD~2", "HEAD", "HEAD~2: its replay differs already"),
        ("HEAD~7", "HEAD~6", "HEAD~6: its replay is the same"),
        ("HEAD~4", "HEAD", "HEAD~4: cannot replay the recording: does not start"),
        ("HEAD", "HEAD", "are one commit"),
        ("nothing", "HEAD", "git rev-parse failed"),
    ],
)
def test_revisions_that_will_not_do_are_refused(repository, good, bad, told):
    with pytest.raises(UsageError, match=told):
        first_bad(repository, good, bad, replay)
    assert len(git(repository, "worktree", "list").splitlines()) == 1


def test_where_the_replay_by_a_common_ancestor_differs_no_commit_is_found(repository):
    git(repository, "checkout", "--quiet", "--force", "-b", "side", "HEAD~2")
    (repository / "word").write_text("good again")
    git(repository, "commit", "--quiet", "--all", "-m", "Mended on the side")
    with pytest.raises(UsageError, match="git bisect cannot go on"):
        first_bad(repository, "side", "@{-1}", replay)


def test_an_environment_is_made_once_for_a_lock_and_not_at_all_if_this_one_has_it(tmp_path):
    assert environment(HERE, tmp_path / "none") == Path(sys.executable)
    (tmp_path / LOCK).write_text("msgspec==0.0.1 \\\n    --hash=sha256:00\n")
    installed = []

    def install(folder: Path, lock: Path) -> None:
        installed.append(lock.read_text())
        (folder / "bin").mkdir()
        (folder / "bin" / "python").touch()

    first = environment(tmp_path, tmp_path / "cache", install)
    assert first.is_file()
    assert environment(tmp_path, tmp_path / "cache", install) == first
    assert len(installed) == 1
    (tmp_path / LOCK).write_text("msgspec==0.0.2 \\\n    --hash=sha256:00\n")

    def fail(folder: Path, lock: Path) -> None:
        raise RunError("no network")

    with pytest.raises(RunError, match="no network"):
        environment(tmp_path, tmp_path / "cache", fail)
    assert [*(tmp_path / "cache").iterdir()] == [first.parents[1]], "nothing that is half made is kept"
    assert environment(tmp_path, tmp_path / "cache", install) != first


def test_the_packages_of_a_worktree_of_dynpf_are_found_and_none_in_one_of_something_else(tmp_path):
    assert {str(HERE), str(HERE / "protocol"), str(HERE / "lab")} <= set(search_path(HERE))
    assert search_path(tmp_path) == []
