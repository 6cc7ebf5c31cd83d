"""Puts the page's ES modules into one script: each in a scope of its own, after those that it needs."""

import re
from collections.abc import Mapping

__all__ = ["bundled"]

_IMPORT = re.compile(r'^import \{ ([\w, ]+) \} from "\./(\w+)\.mjs";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?:async )?(?:function|const) (\w+)", re.MULTILINE)
_ANY = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)


def bundled(modules: Mapping[str, str], entry: str) -> str:
    """Return the script that does what the module ``entry`` does; ``modules`` maps names to sources.

    Imports are ``import { a, b } from "./name.mjs";`` on a line of their own, and exports are functions and
    constants where they are declared. Raises ValueError for another form, for a name that is not exported, and for
    modules that need each other in a circle.
    """
    parts: list[str] = []
    done: list[str] = []

    def add(name: str, path: tuple[str, ...]) -> None:
        """Append a module after those that it imports."""
        if name in path:
            raise ValueError(f"modules need each other in a circle: {' -> '.join((*path, name))}")
        if name in done:
            return
        source = modules[name]
        for names, other in _IMPORT.findall(source):
            missing = {*names.split(", ")} - {*_EXPORT.findall(modules[other])}
            if missing:
                raise ValueError(f"{name}.mjs imports {', '.join(sorted(missing))}, which {other}.mjs does not export")
            add(other, (*path, name))
        parts.append(_scoped(name, source))
        done.append(name)

    add(entry, ())
    return "\n".join(parts)


def _scoped(name: str, source: str) -> str:
    exported = _EXPORT.findall(source)
    body = _IMPORT.sub(r"const { \1 } = module_\2;", source)
    body = _EXPORT.sub(lambda match: match[0].removeprefix("export "), body)
    if left := _ANY.search(body):
        raise ValueError(f"{name}.mjs: {left[0]!r}: neither a plain import nor the export of a function or constant")
    return f"const module_{name} = (() => {{\n{body}\nreturn {{ {', '.join(exported)} }};\n}})();"
