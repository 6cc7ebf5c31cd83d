"""Takes docs/page.png, the picture of a page in the README: `python -m docs.page`, after `make test-browser`.

Runs room-scan with seed 1, in one process, and has Chromium show its page.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from dynpf_lab.notebook import run

__all__ = ["main"]

PICTURE = Path(__file__).with_name("page.png")
BROWSER = Path(__file__).parents[1] / "tests/browser"


def main() -> int:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None or not (BROWSER / "node_modules").is_dir():
        print("docs.page: needs Chromium and the packages of make test-browser", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room-scan.mcap"
        made = run("room-scan", seed=1, path=path)
        page = made.page(path.with_suffix(".html"))
        subprocess.run(["node", BROWSER / "picture.mjs", chromium, page, PICTURE], check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
