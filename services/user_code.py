"""A user's own classes, which a scenario names as ``package.module:Name``: where they are, and which source it is.

They are found on the Python path, which PYTHONPATH lengthens; every process of a run inherits it. A recording carries
no code: it names the modules and a digest of each one's source, so that a replay can tell whether it has the same.
"""

import difflib
import hashlib
import importlib
import importlib.util
import traceback
from collections.abc import Iterable
from pathlib import Path

from services.errors import ScenarioError

__all__ = ["find_class", "source_digests"]


def find_class(name: str, key: str) -> type:
    """Return the class ``package.module:Name``; raises ScenarioError with the key that names it and what is missing."""
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute, None)
        known = [one for one, value in vars(importlib.import_module(module)).items() if isinstance(value, type)]
    except ModuleNotFoundError as error:
        raise ScenarioError(f"{key}: {name!r}: {_not_found(module, error)}") from error
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        told = f"{type(error).__name__}: {error} ({place.filename}:{place.lineno})"
        raise ScenarioError(f"{key}: {name!r}: the module cannot be imported: {told}") from error
    if not isinstance(found, type):
        what = "is no class" if found is not None else "is not in the module"
        close = difflib.get_close_matches(attribute, known, n=1)
        raise ScenarioError(f"{key}: {name!r}: {attribute} {what}{f'; did you mean {close[0]!r}?' if close else ''}")
    return found


def source_digests(named: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the digest of each module's source, by the module's name; ``named`` are keys and the classes they name.

    Raises ScenarioError for a module that is not there.
    """
    return {name.partition(":")[0]: _source_digest(name, key) for key, name in named}


def _source_digest(name: str, key: str) -> str:
    """Return the SHA-256 over the module's file, or over all Python files of the outermost package that it lies in."""
    module = name.partition(":")[0]
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError as error:
        raise ScenarioError(f"{key}: {name!r}: {_not_found(module, error)}") from error
    if spec is None:
        raise ScenarioError(f"{key}: {name!r}: {_not_found(module, None)}")
    if not spec.has_location or spec.origin is None:
        raise ScenarioError(f"{key}: {name!r}: the module {module!r} has no source file, by which it could be known")
    file = Path(spec.origin)
    root = file.parent
    while (root / "__init__.py").is_file():
        root = root.parent
    package = root / file.relative_to(root).parts[0]
    files = sorted(package.rglob("*.py")) if package.is_dir() else [file]
    digest = hashlib.sha256()
    for path in files:
        try:
            source = path.read_bytes()
        except OSError as error:
            raise ScenarioError(f"{key}: {name!r}: its source {path} cannot be read: {error.strerror}") from error
        digest.update(f"{path.relative_to(root).as_posix()} {len(source)}\n".encode())
        digest.update(source)
    return digest.hexdigest()


def _not_found(module: str, error: ModuleNotFoundError | None) -> str:
    lacking = module if error is None or error.name is None else error.name
    if module == lacking or module.startswith(f"{lacking}."):
        return f"there is no module {lacking!r} on the Python path; name the folder that it is in in PYTHONPATH"
    return f"its module needs the module {lacking!r}, which is not installed"
