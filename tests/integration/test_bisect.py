"""The commit of a repository of nodes that made the replay of a recording differ, found by replays of its commits."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

DYNPF = Path(sys.executable).with_name("dynpf")
EXAMPLE = Path(__file__).parents[2] / "examples" / "uwb"


def test_the_commit_that_changed_a_node_is_found(tmp_path: Path) -> None:
    folder = shutil.copytree(EXAMPLE, tmp_path / "own")

    def call(*words: str) -> str:
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=240, check=False)
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        return done.stdout

    def commit(subject: str) -> None:
        call("git", "add", "uwb.py", "uwb.toml")
        call("git", "-c", "user.name=me", "-c", "user.email=me@example.org", "commit", "-m", subject)

    call("git", "init")
    commit("First")
    run = ("run", "uwb.toml", "--set", "max_ticks=20", "--runner", "inline", "--no-page")
    call(str(DYNPF), *run, "-o", "run.mcap")
    module = folder / "uwb.py"
    module.write_text(module.read_text().replace("noise = self.sigma", "noise = 1.5 * self.sigma"))
    commit("More noise")
    asked = ("bisect", "run.mcap", "--repo", ".", "--good", "HEAD~1", "--code", ".", "--allow-code", "uwb", "--json")
    found = json.loads(call(str(DYNPF), *asked))["commit"]
    assert (found["subject"], found["changes_lock"]) == ("More noise", False)
    first = found["tried"]["first"]
    assert (first["node"], first["topic"], first["field"]) == ("ranging", "ranging/ranges", "ranges[0]")
