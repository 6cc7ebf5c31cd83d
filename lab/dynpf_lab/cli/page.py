"""The page that commands leave beside a recording, and what they say of it."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import DynpfError

from dynpf_lab.cli.failures import sentence

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording

__all__ = ["add_no_page", "leave_page"]


def add_no_page(parser: argparse.ArgumentParser, text: str = "make no page (NAME.html beside the recording)") -> None:
    """Add --no-page."""
    parser.add_argument("--no-page", action="store_true", help=text)


def leave_page(
    command: str, path: Path, recording: "Recording | None" = None, measures: Mapping[str, Any] | None = None
) -> Path | None:
    """Make the page of a recording beside it and return its path; where that fails, say so in a line, and return None.

    ``recording`` and ``measures`` are those of the file at ``path``, where they are known.
    """
    from dynpf_formats.recording.reader import read_recording

    from dynpf_lab.page import make_page, page_of

    page = page_of(path)
    try:
        make_page([recording or read_recording(path, allow_truncated=True)], page, measures)
    except DynpfError as error:
        print(f"dynpf {command}: no page: {error}", file=sys.stderr)
    except Exception as error:  # the run is recorded and measured: nothing of that is lost for want of a picture
        print(f"dynpf {command}: no page: {sentence(error)}", file=sys.stderr)
    else:
        return page
    return None
