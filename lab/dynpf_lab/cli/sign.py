"""``dynpf sign``: sign the bytes of a recording."""

import argparse
from datetime import UTC, datetime
from pathlib import Path

from dynpf_lab.cli.arguments import add_recording

__all__ = ["add_arguments", "add_sign", "check_key", "sign_recording"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf sign``."""
    add_recording(parser)
    parser.add_argument(
        "--key", type=Path, required=True, metavar="NAME.key", help="the ed25519 key, with NAME.pem beside it"
    )
    parser.set_defaults(run=run)


def add_sign(parser: argparse.ArgumentParser) -> None:
    """Add ``--sign`` of the commands that record."""
    parser.add_argument("--sign", type=Path, metavar="NAME.key", help="sign the recording (NAME.pem is beside it)")


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf sign`` and return its exit code."""
    from dynpf_formats.recording.reader import load
    from dynpf_formats.recording.signature import signature_file
    from dynpf_protocol.errors import UsageError

    load(options.recording)  # what is no recording is refused
    if (signature := signature_file(options.recording)).exists():
        raise UsageError(f"{signature}: the recording is signed already (dynpf doctor says by whom); remove it first")
    print(sign_recording(options.recording, options.key))
    return 0


def sign_recording(recording: Path, key: Path) -> Path:
    """Sign a recording now and return the signature's path; raises UsageError for an unusable key."""
    from dynpf_formats.recording.signature import load_signer, sign

    now = datetime.now(UTC)
    return sign(recording, load_signer(key, now), now)


def check_key(key: Path) -> None:
    """Raise UsageError for an unusable key, before anything is recorded that it is to sign."""
    from dynpf_formats.recording.signature import load_signer

    load_signer(key, datetime.now(UTC))
