"""A twin follows a real run to its end, cannot hold it up, and finds a node that does not do the same again."""

import json
import os
import re
import shutil
import signal
from pathlib import Path

from tests.integration.processes import ROOT, Child, until


def folder_of(run: Child) -> str:
    """Return the folder that a run names when it begins."""
    run.says("observer and operator")
    found = re.search(r"--keys (.*)/guests", run.stderr)
    assert found is not None
    return found[1]


def test_a_twin_follows_a_run_to_its_end_and_holds_nobody_up_when_it_is_stopped_itself(tmp_path, dynpf, here):
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--set", "rate=5", "--no-page", "-o", path)
    twin = dynpf("replay", "--follow", folder_of(run), "--json")
    twin.says("following the run at tls/127.0.0.1:")
    os.kill(twin.popen.pid, signal.SIGSTOP)
    size = path.stat().st_size
    until(lambda: path.stat().st_size > size + 20_000, "the run goes on")
    run.interrupt()
    assert run.wait() == 0, run.stderr
    os.kill(twin.popen.pid, signal.SIGCONT)
    assert twin.wait() == 0, (twin.stdout, twin.stderr)
    told = json.loads(twin.stdout)
    assert (told["same"], told["first"], told["unchecked"], told["refused"]) == (True, None, 0, 0)
    replayed = json.loads(here("replay", path, "--json").out)
    counts = {name: (node["steps"], node["messages"]) for name, node in replayed["counts"].items()}
    assert {name: (node["steps"], node["messages"]) for name, node in told["counts"].items()} == counts
    assert {tuple(node["from"]) for node in told["counts"].values()} == {(0,)}


def test_a_node_that_does_not_do_the_same_again_is_found_while_the_run_goes_on(tmp_path, dynpf):
    own = shutil.copytree(ROOT / "examples" / "uwb", tmp_path / "own")
    module: Path = own / "uwb.py"
    code = module.read_text().replace("noise = self.sigma", "noise = os.getpid() + self.sigma")
    module.write_text(f"import os\n{code}")
    run = dynpf(
        "run", own / "uwb.toml", "--set", "rate=1", "--set", "max_ticks=10000", "--no-page", "-o", tmp_path / "run.mcap"
    )
    follow = ("replay", "--follow", folder_of(run), "--code", own)
    refused = dynpf(*follow)
    assert refused.wait() == 2
    assert "a twin runs no code of your computer unless you allow it: --allow-code uwb" in refused.stderr
    twin = dynpf(*follow, "--allow-code", "uwb")
    assert twin.wait() == 1, twin.stderr
    assert run.popen.poll() is None, "it does not wait for the end of the run"
    told = r"first divergence: node ranging, tick 0, ranging/ranges 0, ranges\[0\], byte \d+: recorded \d+"
    assert re.search(told, twin.stdout), twin.stdout
    run.interrupt()
    assert run.wait() == 0, run.stderr
