"""What docs/regression.md says to do for references of one's own is done as written, and finds what changed."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

DYNPF = Path(sys.executable).with_name("dynpf")
ROOT = Path(__file__).parents[2]


def test_the_page_on_references_of_ones_own_holds(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "regression.md").read_text()
    (table,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    commands = re.findall(r"^\$ (.*)$", page, flags=re.MULTILINE)[:4]
    folder = shutil.copytree(ROOT / "examples" / "uwb", tmp_path / "own")
    (folder / "regress").mkdir()
    (folder / "regress" / "references.toml").write_text(table)

    def shell(command: str) -> subprocess.CompletedProcess[str]:
        words = command.replace("dynpf ", f"{DYNPF} ", 1)
        return subprocess.run(words, shell=True, cwd=folder, capture_output=True, text=True, timeout=240, check=False)

    for command in ("git init", "git config user.name me", "git config user.email me@example.org", "git add uwb*"):
        assert shell(command).returncode == 0
    assert shell("git commit -m Scenario").returncode == 0
    for command in commands:
        done = shell(command)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
    assert done.stdout.count("same") == 8, "the file, six nodes, and the run that is not kept"
    module = folder / "uwb.py"
    module.write_text(module.read_text().replace("self.sigma", "self.sigma * 1.5", 1))  # the control
    done = shell(commands[-1])
    assert done.returncode == 1, done.stdout
    assert "first difference: node ranging, tick" in done.stdout
