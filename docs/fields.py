"""What structs say of themselves: types, ranges and defaults, and the comments beside their fields, as tables."""

import ast
import inspect
import io
import textwrap
import tokenize
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from dynpf_services.scenario.user_component import UserComponent
from msgspec import inspect as types

__all__ = ["Structs", "anchor", "described", "inside", "pieces_of", "struct_of", "table", "type_text"]

TIMES = {"Timestamp", "Duration"}

Structs = dict[str, types.StructType]


def inside(info: types.Type) -> tuple[list[types.StructType], bool]:
    """Return the structs that a value of a type may be, and whether it is a list of them."""
    match info:
        case types.StructType():
            return [info], False
        case types.UnionType(types=choices):
            return [one for one in choices if isinstance(one, types.StructType)], False
        case types.VarTupleType(item_type=item):
            return inside(item)[0], True
    return [], False


def pieces_of(info: types.Type) -> Structs:
    """Return the structs inside a message by name, times left out."""
    match info:
        case types.StructType(fields=fields):
            found: Structs = {}
            for field in fields:
                for inner in inside(field.type)[0]:
                    if inner.cls.__name__ not in TIMES:
                        found |= {inner.cls.__name__: inner, **pieces_of(inner)}
            return found
    return {}


def described(info: types.StructType, links: Structs) -> list[str]:
    """Return a struct's docstring and the table of its fields."""
    lines = [*inspect.cleandoc(info.cls.__doc__ or "").splitlines(), ""] if info.cls.__doc__ else []
    if info.cls is UserComponent:
        return lines[:-1]
    if not info.fields:
        return [*lines, "No keys."]
    notes = _notes(info.cls)
    rows = (
        (f"`{one.encode_name}`", type_text(one.type, links), _range(one.type), _default(one), notes.get(one.name, ""))
        for one in info.fields
    )
    return [*lines, *table(("Field", "Type", "Range", "Default", "Unit and meaning"), rows)]


def type_text(info: types.Type, links: Mapping[str, Any]) -> str:
    """Return a type as a reader takes it, structs of ``links`` as links to their headings."""
    match info:
        case types.FloatType():
            return "number"
        case types.IntType():
            return "integer"
        case types.BoolType():
            return "true or false"
        case types.StrType():
            return "text"
        case types.BytesType():
            return "base64"
        case types.LiteralType(values=values):
            return " or ".join(f'`"{value}"`' for value in values)
        case types.EnumType(cls=cls):
            return f"integer ({cls.__name__})"
        case types.StructType(cls=cls):
            name = cls.__name__
            return f"[{name}](#{anchor(name)})" if name in links else ("sec, nsec" if name in TIMES else "table")
        case types.VarTupleType(item_type=item):
            return f"list of {type_text(item, links)}"
        case types.TupleType(item_types=items):
            return f"{len(items)} x {type_text(items[0], links)}"
        case types.DictType(value_type=value):
            return f"table of {type_text(value, links)}"
        case types.UnionType(types=choices):
            return " or ".join(dict.fromkeys(type_text(one, links) for one in choices if not _none(one)))
    return type(info).__name__


def _none(info: types.Type) -> bool:
    return isinstance(info, types.NoneType)


def _range(info: types.Type) -> str:
    match info:
        case types.FloatType() | types.IntType():
            bounds = (
                (">=", info.ge),
                (">", info.gt),
                ("<=", info.le),
                ("<", info.lt),
                ("multiple of", info.multiple_of),
            )
            return ", ".join(f"{word} {_number(value)}" for word, value in bounds if value is not None)
        case types.VarTupleType(item_type=item, min_length=low, max_length=high):
            if low is not None and low == high:
                return f"{low} of them"
            lengths = [f"at least {low}" if low else "", f"at most {high}" if high is not None else ""]
            each = _range(item)
            return ", ".join([*filter(None, lengths), *([f"each {each.removeprefix('each ')}"] if each else [])])
        case types.TupleType(item_types=items):
            return f"each {_range(items[0])}" if _range(items[0]) else ""
        case types.UnionType(types=choices):
            return next(filter(None, map(_range, choices)), "")
    return ""


def _number(value: float) -> str:
    if isinstance(value, int) and value >= 2**31 and value & (value - 1) == 0:
        return f"2^{value.bit_length() - 1}"
    return f"{value:g}"


def _default(field: types.Field) -> str:
    if field.required:
        return "required"
    if field.default_factory is not msgspec.NODEFAULT:
        return "computed" if field.default_factory not in (list, dict) else "empty"
    if field.default is msgspec.NODEFAULT:  # UNSET: the field need not be there
        return "left out"
    value = msgspec.to_builtins(field.default)
    match value:
        case None:
            return "absent"
        case bool():
            return str(value).lower()
        case float():
            return f"{value:.6g}"
        case "":
            return "empty"
        case dict():
            return "its defaults"
        case [] | ():
            return "empty"
        case [dict(), *_] | (dict(), *_):
            return "one, its defaults"
        case list() | tuple():
            return f"[{', '.join(one if isinstance(one, str) else f'{one:.6g}' for one in value)}]"
    return str(value)


def _notes(kind: type) -> dict[str, str]:
    """Return what the source says beside, above or, as a text, below each field of a struct; inherited ones first."""
    bases = [base for base in reversed(kind.__mro__) if issubclass(base, msgspec.Struct) and base is not msgspec.Struct]
    return {name: note for base in bases for name, note in _own_notes(base).items()}


def _own_notes(kind: type) -> dict[str, str]:
    try:
        source = textwrap.dedent(inspect.getsource(kind))
    except OSError:  # made of a list: there is no source, and the tables that it holds have their own
        return {}
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    statement = ast.parse(source).body[0]
    assert isinstance(statement, ast.ClassDef)
    code = {row for node in statement.body for row in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    notes: dict[str, str] = {}
    name = ""
    for node in statement.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name = node.target.id
            above: list[str] = []
            row = node.lineno - 1
            while row in comments and row not in code:
                above.insert(0, comments[row])
                row -= 1
            beside = comments.get(node.end_lineno or node.lineno)
            notes[name] = " ".join([*above, *([beside] if beside else [])])
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and name:
            notes[name] = " ".join(str(node.value.value).split())
    return {name: note for name, note in notes.items() if note}


def struct_of(kind: type) -> types.StructType:
    """Return what msgspec knows of a struct."""
    info = types.type_info(kind)
    assert isinstance(info, types.StructType)
    return info


def anchor(title: str) -> str:
    """Return what a link to a heading is called."""
    return title.lower().replace(".", "")


def table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [head, ("---",) * len(head), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]
