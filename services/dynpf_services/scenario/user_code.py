"""User classes, which a scenario names as ``package.module:Name``: finding, importing and digesting them.

They are found beside the scenario's file, in folders that the command line names, or on the Python path; always after
all installed packages, so that no user file can shadow one of dynpf. A recording contains no code: it names the modules
with a digest of each one's source, so that a replay can check whether it has the same.

Importing a module executes it. So modules that a recording names are only imported if its reader has allowed them by
name, and this is the only module that imports what a text names.
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
    """Return the folders that are searched for user modules: ``code``, and that of a scenario's file.

    Raises UsageError for a path that is no folder.
    """
    folders = [*code]
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"--code {folder}: no such folder")
    path = Path(scenario)
    return [*folders, path.parent] if path.suffix == ".toml" else folders


def add_folders(folders: Iterable[Path]) -> None:
    """Append ``folders`` to the module search path, after everything that this process can import already."""
    for folder in folders:
        path = str(folder.absolute())
        if path not in sys.path:
            sys.path.append(path)


def check_allowed(named: Iterable[UserClass], modules: Container[str], where: str, what: str = "a recording") -> None:
    """Raise ScenarioError with a line for each class whose module is not among ``modules``.

    ``where`` names the recording, or ``what`` else names the classes. Nothing is imported.
    """
    problems = []
    for user in named:
        if is_standard(user.module):
            problems.append(f"{where}: {_standard(user)}")
        elif user.module not in modules:
            problems.append(
                f"{where}: {user.key}: names the class {user.name} of the module {user.module}, which did not come "
                f"along; {what} runs no code of your computer unless you allow it: --allow-code {user.module}"
            )
    if problems:
        raise ScenarioError("\n".join(problems))


def find_class(user: UserClass) -> type:
    """Import a class and return it; raises ScenarioError with the key that names it and what is missing."""
    return find_value(user, type, "class")


def find_value(user: UserClass, kind: type[T], what: str) -> T:
    """Import an object of type ``kind`` and return it; raises ScenarioError, in which ``what`` names the type."""
    if is_standard(user.module):
        raise _standard(user)
    try:
        module = importlib.import_module(user.module)
        found = getattr(module, user.name, None)
    except Exception as error:
        raise _not_imported(user, error) from error
    if not isinstance(found, kind):
        wrong = f"is no {what}" if found is not None else "is not in the module"
        known = [name for name, value in vars(module).items() if isinstance(value, kind)]
        close = difflib.get_close_matches(user.name, known, n=1)
        raise user.wrong(f"{user.name} {wrong}{f'; did you mean {close[0]!r}?' if close else ''}")
    return found


def source_digests(named: Iterable[UserClass]) -> dict[str, str]:
    """Return the digest of each module's source, by the module's name.

    This imports the packages that contain a module. Raises ScenarioError for a module that does not exist.
    """
    return {user.module: _source_digest(user) for user in named}


def _source_digest(user: UserClass) -> str:
    """Return the SHA-256 over the module's file, or over all Python files of the outermost package that contains it."""
    if is_standard(user.module):
        raise _standard(user)
    try:
        spec = importlib.util.find_spec(user.module)
    except Exception as error:
        raise _not_imported(user, error) from error
    if spec is None:
        raise user.wrong(_not_found(user.module, None))
    if not spec.has_location or spec.origin is None:
        raise user.wrong(f"the module {user.module!r} has no source file, by which it could be known")
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
            raise user.wrong(f"its source {path} cannot be read: {error.strerror}") from error
        digest.update(f"{path.relative_to(root).as_posix()} {len(source)}\n".encode())
        digest.update(source)
    return digest.hexdigest()


def _standard(user: UserClass) -> ScenarioError:
    return user.wrong(f"{user.module} is a module of Python's own, which holds no component; it is not imported")


def _not_imported(user: UserClass, error: Exception) -> ScenarioError:
    if isinstance(error, ModuleNotFoundError):
        return user.wrong(_not_found(user.module, error))
    frame = traceback.extract_tb(error.__traceback__)[-1]
    text = f"{type(error).__name__}: {error} ({frame.filename}:{frame.lineno})"
    return user.wrong(f"the module cannot be imported: {text}")


def _not_found(module: str, error: ModuleNotFoundError | None) -> str:
    lacking = module if error is None or error.name is None else error.name
    if module == lacking or module.startswith(f"{lacking}."):
        return f"no module {lacking!r} is beside the scenario or on the Python path; --code FOLDER names its folder"
    return f"its module needs the module {lacking!r}, which is not installed"
