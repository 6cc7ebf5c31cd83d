"""``dynpf export``: a topic of a recording in a format that other programs read."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_recording

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording

__all__ = ["add_arguments"]

TABLES = ("tum", "csv", "parquet")
VIEWERS = {"foxglove": ".foxglove.mcap", "rerun": ".rrd"}
FORMATS = (*TABLES, *VIEWERS)
PREFERRED = ("estimator/state", "log/truth", "truth/robot")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf export``."""
    add_recording(parser)
    parser.add_argument(
        "--format",
        choices=FORMATS,
        help="tum: poses as evo reads them; csv, parquet: a row for each message; foxglove, rerun: the whole run for "
        "Foxglove, Lichtblick and Rerun, or for Rerun alone (default: by the name of the file)",
    )
    parser.add_argument("--topic", help=f"which; else the first there is of {', '.join(PREFERRED)}")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        type=Path,
        help="file to be written; else standard output, for a viewer a file beside the recording",
    )
    parser.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    from dynpf_formats.recording.reader import read_recording

    chosen = options.format or _format_of(options.output)
    recording = read_recording(options.recording)
    if chosen in VIEWERS:
        return _for_viewers(recording, chosen, options)
    topic = _topic(recording, options.topic)
    count = {"tum": _tum, "csv": _csv, "parquet": _parquet}[chosen](recording, topic, options)
    print(f"{count} of {topic} written to {options.output or 'standard output'}", file=sys.stderr)
    return 0


def _format_of(path: Path | None) -> str:
    """Return the format that a file's name asks for; raises UsageError if it asks for none."""
    if path is not None and path.suffix == VIEWERS["rerun"]:
        return "rerun"
    if path is not None and path.suffix.removeprefix(".") in TABLES:
        return path.suffix.removeprefix(".")
    raise UsageError(
        f"--format: missing; expected one of {', '.join(FORMATS)}, or -o FILE that ends in one of "
        f"{', '.join(TABLES)} or rrd"
    )


def _for_viewers(recording: "Recording", chosen: str, options: argparse.Namespace) -> int:
    """Write the whole run as a file for viewers, and return the exit code."""
    from dynpf_lab.cli.export_run import export

    if options.topic is not None:
        raise UsageError(f"--topic {options.topic}: --format {chosen} takes the whole run")
    path = options.output or options.recording.with_suffix(VIEWERS[chosen])
    with _writing(path):
        count = export(recording, chosen, path)
    print(f"{count} messages written to {path}", file=sys.stderr)
    return 0


def _topic(recording: "Recording", wanted: str | None) -> str:
    from dynpf_protocol.journal import JOURNAL_PREFIX
    from dynpf_protocol.snapshots import SNAPSHOT_PREFIX

    there = {topic for topic in recording.schemas if not topic.startswith((JOURNAL_PREFIX, SNAPSHOT_PREFIX))}
    found = next((topic for topic in ((wanted,) if wanted else PREFERRED) if topic in there), None)
    if found is None:
        listed = ", ".join(sorted(there)) or "no messages"
        raise UsageError(f"{recording.path}: nothing on {wanted or ' or '.join(PREFERRED)}; it has {listed}")
    return found


def _tum(recording: "Recording", topic: str, options: argparse.Namespace) -> int:
    from dynpf_formats.exporters.trajectory import pose_topics, tum_lines

    if topic not in (known := pose_topics(recording)):
        raise UsageError(f"{topic} holds no poses; those of this recording with poses: {', '.join(known) or 'none'}")
    count = 0
    with _text(options.output) as stream:
        for line in tum_lines(recording, topic):
            stream.write(f"{line}\n")
            count += 1
    return count


def _csv(recording: "Recording", topic: str, options: argparse.Namespace) -> int:
    from dynpf_formats.exporters.table import write_csv

    with _text(options.output) as stream:
        return write_csv(recording, topic, stream)


def _parquet(recording: "Recording", topic: str, options: argparse.Namespace) -> int:
    from dynpf_experiments.extras import needing

    if options.output is None:
        raise UsageError("--format parquet needs -o FILE: it is not text")
    with needing("pyarrow", extra="parquet", what="writing Parquet"):
        from dynpf_formats.exporters.parquet import write_parquet
    with _writing(options.output):
        return write_parquet(recording, topic, options.output)


@contextmanager
def _text(path: Path | None) -> Iterator[TextIO]:
    if path is None:
        yield sys.stdout
        return
    with _writing(path), path.open("x", encoding="utf-8", newline="") as stream:
        yield stream


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except FileExistsError:
        raise UsageError(f"{path}: the file exists; choose another name") from None
    except BrokenPipeError:
        raise
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
