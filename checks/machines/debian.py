"""Debian's packages, unpacked into a folder of the checkout: no root, no installation, signatures checked by apt."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from dynpf_lab.references.table import CHECKOUT
from dynpf_protocol.errors import UsageError

__all__ = ["CACHE", "host_architecture", "unpacked"]

CACHE = CHECKOUT / ".machines"
"""What is downloaded and what the runs leave; git ignores it."""

KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")


def host_architecture() -> str:
    """Return Debian's name of this machine's architecture."""
    return _told(["dpkg", "--print-architecture"]).strip()


def unpacked(suite: str, architecture: str, packages: Sequence[str]) -> Path:
    """Return the folder with packages of a release of Debian and all that they depend on, unpacked.

    The first call downloads them, from DEBIAN_MIRROR or the mirror that this machine's apt uses. Raises UsageError
    where apt's tools or Debian's keyring are missing.
    """
    folder = CACHE / "debian" / f"{suite}-{architecture}-{packages[0]}"
    if folder.is_dir():
        return folder
    for tool in ("apt-get", "dpkg-deb"):
        if shutil.which(tool) is None:
            raise UsageError(f"{tool} is not installed; packages of Debian are unpacked by it")
    if not KEYRING.is_file():
        raise UsageError(f"{KEYRING}: no such file; install debian-archive-keyring, by which signatures are checked")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix="new-") as temporary:
        state, new = Path(temporary) / "apt", Path(temporary) / "root"
        for archive in _downloaded(state, suite, architecture, packages):
            _told(["dpkg-deb", "--extract", str(archive), str(new)])
        # Debian's base-files makes these links where a release keeps everything below /usr.
        for name in ("bin", "lib", "lib64"):
            if not (new / name).exists() and (new / "usr" / name).is_dir():
                (new / name).symlink_to(f"usr/{name}")
        new.rename(folder)
    return folder


def _downloaded(state: Path, suite: str, architecture: str, packages: Sequence[str]) -> list[Path]:
    """Download packages and their dependencies with a state of apt that knows of no installed ones."""
    for name in ("lists/partial", "cache/archives/partial", "etc/preferences.d"):
        (state / name).mkdir(parents=True)
    (state / "status").touch()
    (state / "sources.list").write_text(f"deb [signed-by={KEYRING}] {_mirror()} {suite} main\n", encoding="utf-8")
    options = {
        "APT::Architecture": architecture,
        "APT::Architectures": architecture,
        "APT::Sandbox::User": "",
        "Acquire::Languages": "none",
        "Dir::State": state,
        "Dir::State::Lists": state / "lists",
        "Dir::State::Status": state / "status",
        "Dir::Cache": state / "cache",
        "Dir::Etc": state / "etc",
        "Dir::Etc::SourceList": state / "sources.list",
        "Dir::Etc::SourceParts": "/dev/null",
    }
    apt = ["apt-get", "--quiet", *(word for name, value in options.items() for word in ("-o", f"{name}={value}"))]
    _told([*apt, "update"])
    _told([*apt, "--yes", "--download-only", "--no-install-recommends", "install", *packages])
    return sorted((state / "cache/archives").glob("*.deb"))


def _mirror() -> str:
    """Return where Debian's packages come from: what DEBIAN_MIRROR says, else what this machine's apt uses."""
    if mirror := os.environ.get("DEBIAN_MIRROR"):
        return mirror
    told = _told(["apt-get", "indextargets", "--format", "$(REPO_URI) $(ORIGIN) $(CREATED_BY)"])
    found = [words[0] for line in told.splitlines() if (words := line.split())[1:] == ["Debian", "Packages"]]
    main = [address for address in dict.fromkeys(found) if address.rstrip("/").endswith("/debian")]
    if not main:
        raise UsageError("this machine's apt knows no mirror of Debian; set DEBIAN_MIRROR to the address of one")
    return main[0]


def _told(command: Sequence[str]) -> str:
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise UsageError(f"{' '.join(command[:2])} ... failed: {(ended.stderr or ended.stdout).strip()[-600:]}")
    return ended.stdout
