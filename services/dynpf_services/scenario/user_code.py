"""A user's own classes, which a scenario names as ``package.module:Name``: where they are, and which source it is.

They are found beside the scenario's file, in folders that the command line names, or on the Python path; always behind
all that is installed, so that no file of the user's can take the place of one of ours. A recording carries no code: it
names the modules and a digest of each one's source, so that a replay can tell whether it has the same.
To import a module is to run it. So nothing here is called for what a recording names, unless its reader has allowed the
module by name; and this is the only place that imports what a text names.
"""

import difflib
import hashlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Container, Iterable
from pathlib import Path
from typing import TypeVar

from dynpf_formats.user_classes import UserClass, is_standard
from dynpf_protocol.errors import ScenarioError, UsageError

__all__ = ["add_folders", "check_allowed", "code_folders", "find_class", "find_value", "source_digests"]

T = TypeVar("T")


def code_folders(code: Iterable[Path], scenario: str = "") -> list[Path]:
    """Return the folders in which modules of the user's are looked for: ``code``, and that of a scenario's file.

    Raises UsageError for one that is no folder.
    """
    folders = [*code]
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"--code {folder}: no such folder")
    path = Path(scenario)
    return [*folders, path.parent] if path.suffix == ".toml" else folders


def add_folders(folders: Iterable[Path]) -> None:
    """Let modules be found in ``folders``, behind everything that this process can import already."""
    for folder in folders:
        path = str(folder.absolute())
        if path not in sys.path:
            sys.path.append(path)


def check_allowed(named: Iterable[UserClass], modules: Container[str], where: str) -> None:
    """Raise ScenarioError, a line for each class whose module is not among ``modules``; ``where`` names the recording.

    Nothing is imported or looked for.
    """
    problems = []
    for one in named:
        if is_standard(one.module):
            problems.append(f"{where}: {_standard(one)}")
        elif one.module not in modules:
            problems.append(
                f"{where}: {one.key}: names the class {one.name} of the module {one.module}, which did not come along; "
                f"a recording runs no code of your computer unless you allow it: --allow-code {one.module}"
            )
    if problems:
        raise ScenarioError("\n".join(problems))


def find_class(one: UserClass) -> type:
    """Import a class; raises ScenarioError with the key that names it and what is missing."""
    return find_value(one, type, "class")


def find_value(one: UserClass, kind: type[T], what: str) -> T:
    """Import what a name stands for, a ``kind``, which is called ``what``; raises ScenarioError as ``find_class``."""
    if is_standard(one.module):
        raise _standard(one)
    try:
        module = importlib.import_module(one.module)
        found = getattr(module, one.name, None)
    except Exception as error:
        raise _not_imported(one, error) from error
    if not isinstance(found, kind):
        wrong = f"is no {what}" if found is not None else "is not in the module"
        known = [name for name, value in vars(module).items() if isinstance(value, kind)]
        close = difflib.get_close_matches(one.name, known, n=1)
        raise one.wrong(f"{one.name} {wrong}{f'; did you mean {close[0]!r}?' if close else ''}")
    return found


def source_digests(named: Iterable[UserClass]) -> dict[str, str]:
    """Return the digest of each module's source, by the module's name.

    The packages that a module lies in are imported on the way. Raises ScenarioError for a module that is not there.
    """
    return {one.module: _source_digest(one) for one in named}


def _source_digest(one: UserClass) -> str:
    """Return the SHA-256 over the module's file, or over all Python files of the outermost package that it lies in."""
    if is_standard(one.module):
        raise _standard(one)
    try:
        spec = importlib.util.find_spec(one.module)
    except Exception as error:
        raise _not_imported(one, error) from error
    if spec is None:
        raise one.wrong(_not_found(one.module, None))
    if not spec.has_location or spec.origin is None:
        raise one.wrong(f"the module {one.module!r} has no source file, by which it could be known")
    file = Path(spec.origin)
    package, root = file, file.parent
    while (root / "__init__.py").is_file():
        package, root = root, root.parent
    files = sorted(package.rglob("*.py")) if package.is_dir() else [file]
    digest = hashlib.sha256()
    for path in files:
        try:
            source = path.read_bytes()
        except OSError as error:
            raise one.wrong(f"its source {path} cannot be read: {error.strerror}") from error
        digest.update(f"{path.relative_to(root).as_posix()} {len(source)}\n".encode())
        digest.update(source)
    return digest.hexdigest()


def _standard(one: UserClass) -> ScenarioError:
    return one.wrong(f"{one.module} is a module of Python's own, which holds no component; it is not imported")


def _not_imported(one: UserClass, error: Exception) -> ScenarioError:
    if isinstance(error, ModuleNotFoundError):
        return one.wrong(_not_found(one.module, error))
    place = traceback.extract_tb(error.__traceback__)[-1]
    told = f"{type(error).__name__}: {error} ({place.filename}:{place.lineno})"
    return one.wrong(f"the module cannot be imported: {told}")


def _not_found(module: str, error: ModuleNotFoundError | None) -> str:
    lacking = module if error is None or error.name is None else error.name
    if module == lacking or module.startswith(f"{lacking}."):
        return f"no module {lacking!r} is beside the scenario or on the Python path; --code FOLDER names its folder"
    return f"its module needs the module {lacking!r}, which is not installed"
