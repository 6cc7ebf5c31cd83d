"""``dynpf bisect``: which setting, message, module or commit made two runs, or a run and its replay, differ."""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_json
from dynpf_lab.cli.options import add_allow_code, add_code

if TYPE_CHECKING:
    from dynpf_experiments.bisect.comparing import Answer
    from dynpf_experiments.bisect.settings import Change
    from dynpf_formats.recording.diff import FirstDifference

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf bisect``."""
    parser.description = (
        "Of two recordings: which of the settings that differ made the runs differ, by executing A's scenario again "
        "with some of B's settings; or which message is the first that differs, and whether the node that made it had "
        "other inputs or is another. With --repo, of one recording: which commit made its replay differ. The exit code "
        "is 0 if a cause was found, else 1."
    )
    parser.add_argument("a", type=Path, metavar="A.mcap", help="the recording of a run; with --repo the only one")
    parser.add_argument("b", type=Path, nargs="?", metavar="B.mcap", help="that of the run that differs")
    parser.add_argument(
        "--repo",
        type=Path,
        metavar="PATH",
        help="a git repository, of dynpf or of nodes of yours: the recording is replayed by its commits, each in an "
        "environment of its requirements.lock",
    )
    parser.add_argument(
        "--good",
        metavar="REV",
        help="with --repo, a commit whose replay is the same (default: 1, 2, 4 and so on before --bad are tried)",
    )
    parser.add_argument("--bad", metavar="REV", help="with --repo, a later commit whose replay differs (default: HEAD)")
    add_allow_code(parser)
    add_code(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf bisect`` and return its exit code."""
    if (options.repo is None) == (options.b is None):
        raise UsageError("give two recordings, or one and --repo PATH")
    if options.repo is not None:
        return _commits(options)
    if options.good is not None or options.bad is not None:
        raise UsageError("--good and --bad go with --repo")
    from dynpf_experiments.bisect.comparing import compare
    from dynpf_formats.recording.reader import read_recording
    from dynpf_services.scenario.user_code import add_folders, code_folders

    add_folders(code_folders(options.code))
    answer = compare(read_recording(options.a), read_recording(options.b), options.allow_code)
    print(json.dumps(_document(answer)) if options.json else "\n".join(_lines(answer)))
    return 0 if answer.cause else 1


def _commits(options: argparse.Namespace) -> int:
    from dynpf_formats.regular_files import exists

    from dynpf_lab.bisect.commits import Replay, first_bad
    from dynpf_lab.bisect.environments import cache_folder

    if not exists(options.a):
        raise UsageError(f"{options.a}: no such file")
    root = Path("/repository")
    if outside := [folder for folder in options.code if not (root / folder).resolve().is_relative_to(root)]:
        raise UsageError(f"--code {outside[0]}: with --repo, expected a folder in the repository, relative to it")
    words = tuple(word for module in options.allow_code for word in ("--allow-code", module))
    replay = Replay(options.a, words, tuple(options.code), cache_folder())
    found, left = first_bad(options.repo, options.good, options.bad or "HEAD", replay)
    if options.json:
        commit = None if found is None else {**found._asdict(), "tried": found.tried._asdict()}
        print(json.dumps({"commit": commit, "candidates": left}))
    elif found is None:
        print(f"one of these, which cannot replay the recording at all, or the next: {', '.join(left)}")
    else:
        print(f"cause: commit {found.revision[:12]} of {found.date}: {found.subject}")
        if found.changes_lock:
            print("  it changes requirements.lock: other packages may be the reason")
        if (first := found.tried.first) is not None:
            where = (
                f"node {first['node']}, tick {first['tick']}, {first['topic']} {first['sequence']}, {first['field']}"
            )
            print(f"  first difference: {where}: recorded {first['a']!r}, replayed {first['b']!r}")
    return 0 if found is not None else 1


def _lines(answer: "Answer") -> Iterator[str]:
    """Yield what was found, a line for each thing."""
    if answer.first is None:
        yield "the runs are the same: there is no difference to find the cause of"
        return
    yield f"first difference: {_place(answer.first)}"
    for what in answer.made_of:
        yield f"differs: {what}"
    found = answer.found
    if found is not None:
        yield f"settings that differ: {len(found.settings)}; {found.executed} runs executed"
        for name, again in (("A", found.a_again), ("B", found.b_again)):
            if again is not None:
                yield f"{name} is not reproduced here: {_place(again)}; what follows is what its settings make here"
        for cause in found.causes:
            yield f"cause: {' and '.join(map(_change, cause.settings))}"
            yield f"  of what differs from {_place(cause.difference)}"
        if found.without_effect:
            yield f"without effect: {', '.join(change.key for change in found.without_effect)}"
        if found.causes and found.rest is None:
            yield "with these settings alone A's run is B's, byte for byte"
        elif found.rest is not None:
            yield f"with all settings of B this still differs: {_place(found.rest)}"
    elif answer.unsearched:
        yield answer.unsearched
    if answer.origin is not None:
        yield f"{'cause: ' if answer.cause else ''}{answer.origin.text}"
    yield from answer.notes
    if not answer.cause:
        yield "no cause was found"


def _place(first: "FirstDifference") -> str:
    tick = "no tick" if first.tick is None else f"tick {first.tick}"
    where = f"{tick}, node {first.node}, {first.topic} {first.sequence}, {first.field}"
    return f"{where}: {first.a!r} and {first.b!r}"


def _change(change: "Change") -> str:
    return f"{change.key}, {_value(change.a)} in A, {_value(change.b)} in B"


def _value(value: Any) -> str:
    from msgspec import UNSET

    text = "not there" if value is UNSET else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _document(answer: "Answer") -> dict[str, Any]:
    import msgspec

    def settings(changes: Any) -> list[dict[str, Any]]:
        """Return changes with the values that each run has."""
        both = [{"key": change.key, "a": change.a, "b": change.b} for change in changes]
        return [{name: value for name, value in one.items() if value is not msgspec.UNSET} for one in both]

    document: dict[str, Any] = {
        "cause": answer.cause,
        "first": msgspec.to_builtins(answer.first),
        "made_of": answer.made_of,
        "origin": None if answer.origin is None else answer.origin._asdict(),
        "notes": [*answer.notes, *([answer.unsearched] if answer.unsearched else [])],
        "settings": None,
    }
    if (found := answer.found) is not None:
        document["settings"] = {
            "differ": settings(found.settings),
            "causes": [
                {"settings": settings(cause.settings), "first": msgspec.to_builtins(cause.difference)}
                for cause in found.causes
            ],
            "without_effect": settings(found.without_effect),
            "rest": msgspec.to_builtins(found.rest),
            "reproduced": {"a": found.a_again is None, "b": found.b_again is None},
            "executed": found.executed,
        }
    return document
