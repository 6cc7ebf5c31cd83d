"""Runs commands of dynpf in this very process; tells of each what it imported, and what Python saw it open and start.

Reads a JSON list of commands, each a list of words, on stdin; prints one JSON list of what came of them.
"""

import contextlib
import io
import json
import os
import sys
import traceback
from pathlib import Path
from typing import Any

from dynpf_lab.cli import main as command_line

STARTS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.spawn", "webbrowser.open"}


def main() -> None:
    seen: dict[str, list[str]] = {}

    def hook(event: str, words: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(words[0], str | bytes):
            seen.setdefault("opened", []).append(str(Path.cwd() / os.fsdecode(words[0])))
        elif event in STARTS:
            seen.setdefault("started", []).append(event)

    sys.addaudithook(hook)
    told = []
    for words in json.load(sys.stdin):
        seen.clear()
        before = {*sys.modules}
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = command_line.main(words)
            except Exception:
                code = -1
                traceback.print_exc()
        told.append({"words": words, "code": code, "out": out.getvalue(), "err": err.getvalue(), **seen})
        told[-1]["imported"] = sorted({*sys.modules} - before)
    print(json.dumps(told))


if __name__ == "__main__":
    main()
