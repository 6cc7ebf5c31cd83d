"""Conditions: comparisons of measured quantities with numbers or words, joined by ``and``, ``or`` and ``not``.

condition  = term { "or" term }
term       = factor { "and" factor }
factor     = "not" factor | "(" condition ")" | comparison
comparison = NAME ( "<" | "<=" | ">" | ">=" | "==" | "!=" ) ( NUMBER | WORD in quotes | "true" | "false" )
"""

import operator
import re
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from dynpf_protocol.errors import UsageError

__all__ = ["All", "Any", "Comparison", "Condition", "Not", "Value", "comparisons", "holds", "parse", "pointing"]

Value = float | bool | str

_OPERATORS: Mapping[str, Callable[[Value, Value], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
_TOKEN = re.compile(
    r"""\s*(?:(?P<operator><=|>=|==|!=|<|>)|(?P<bracket>[()])|(?P<word>"[^"]*"|'[^']*')"""
    r"""|(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w./]))|(?P<name>\w[\w./]*))"""
)
_MOST_CHARACTERS = 1000
_DEEPEST = 50
_WORDS = ("and", "or", "not", "true", "false")


class Comparison(NamedTuple):
    """A quantity compared with a value; ``at`` is where its name begins in the text."""

    name: str
    operator: str
    value: Value
    at: int


class Not(NamedTuple):
    """The condition that another one does not hold."""

    inner: "Condition"


class All(NamedTuple):
    """The condition that all of several hold."""

    parts: "tuple[Condition, ...]"


class Any(NamedTuple):
    """The condition that any of several holds."""

    parts: "tuple[Condition, ...]"


Condition = Comparison | Not | All | Any


def parse(text: str) -> Condition:
    """Return the condition that a text says; raises UsageError that points at the first place that is wrong."""
    if len(text) > _MOST_CHARACTERS:
        raise UsageError(f"--when: {len(text)} characters; expected at most {_MOST_CHARACTERS}")
    parser = _Parser(text)
    condition = parser.condition(0)
    parser.end()
    return condition


def holds(condition: Condition, values: Mapping[str, Value]) -> bool:
    """Return whether a condition holds; a comparison of a quantity that has no value does not."""
    match condition:
        case Comparison(name, sign, value):
            found = values.get(name)
            return found is not None and _OPERATORS[sign](found, value)
        case Not(inner):
            return not holds(inner, values)
        case All(parts):
            return all(holds(part, values) for part in parts)
        case Any(parts):
            return any(holds(part, values) for part in parts)


def comparisons(condition: Condition) -> Iterator[Comparison]:
    """Yield the comparisons of a condition."""
    match condition:
        case Comparison():
            yield condition
        case Not(inner):
            yield from comparisons(inner)
        case All(parts) | Any(parts):
            for part in parts:
                yield from comparisons(part)


def pointing(text: str, at: int, problem: str) -> UsageError:
    """Return the error that a condition has a problem at a place."""
    return UsageError(f"--when:\n  {text}\n  {' ' * at}^ {problem}")


class _Token(NamedTuple):
    kind: str  # operator, bracket, word, number, name, or end
    text: str
    at: int


class _Parser:
    """Reads a condition from left to right, one token ahead."""

    def __init__(self, text: str) -> None:
        self._text = text.replace("\n", " ").replace("\t", " ")
        self._position = 0
        self._next = self._read()

    def condition(self, depth: int) -> Condition:
        """Read terms joined by "or"."""
        if depth > _DEEPEST:
            raise self._wrong(f"expected at most {_DEEPEST} brackets and nots around a comparison")
        parts = [self._term(depth)]
        while self._take("name", "or"):
            parts.append(self._term(depth))
        return parts[0] if len(parts) == 1 else Any(tuple(parts))

    def end(self) -> None:
        """Raise UsageError unless all has been read."""
        if self._next.kind != "end":
            raise self._wrong('expected "and", "or", or the end')

    def _term(self, depth: int) -> Condition:
        parts = [self._factor(depth)]
        while self._take("name", "and"):
            parts.append(self._factor(depth))
        return parts[0] if len(parts) == 1 else All(tuple(parts))

    def _factor(self, depth: int) -> Condition:
        if depth > _DEEPEST:
            raise self._wrong(f"expected at most {_DEEPEST} brackets and nots around a comparison")
        if self._take("name", "not"):
            return Not(self._factor(depth + 1))
        if self._take("bracket", "("):
            inner = self.condition(depth + 1)
            if not self._take("bracket", ")"):
                raise self._wrong('expected ")"')
            return inner
        return self._comparison()

    def _comparison(self) -> Comparison:
        name = self._next
        if name.kind != "name" or name.text in _WORDS:
            raise self._wrong("expected the name of a quantity, such as position_error")
        self._next = self._read()
        sign = self._next
        if sign.kind != "operator":
            raise self._wrong("expected one of < <= > >= == !=")
        self._next = self._read()
        value = self._value()
        if isinstance(value, str | bool) and sign.text not in {"==", "!="}:
            raise pointing(self._text, sign.at, "words, true and false are compared by == and != alone")
        return Comparison(name.text, sign.text, value, name.at)

    def _value(self) -> Value:
        token = self._next
        self._next = self._read() if token.kind in {"number", "word", "name"} else token
        match token:
            case _Token("number", text):
                return float(text)
            case _Token("word", text):
                return text[1:-1]
            case _Token("name", ("true" | "false") as text):
                return text == "true"
        raise pointing(self._text, token.at, 'expected a number, a word in quotes, "true" or "false"')

    def _take(self, kind: str, text: str) -> bool:
        if (self._next.kind, self._next.text) != (kind, text):
            return False
        self._next = self._read()
        return True

    def _read(self) -> _Token:
        if not self._text[self._position :].strip():
            return _Token("end", "", len(self._text))
        found = _TOKEN.match(self._text, self._position)
        if found is None or found.lastgroup is None:
            at = len(self._text) - len(self._text[self._position :].lstrip())
            raise pointing(self._text, at, "expected a name, a comparison, a number or a bracket")
        self._position = found.end()
        return _Token(found.lastgroup, found[found.lastgroup], found.start(found.lastgroup))

    def _wrong(self, expected: str) -> UsageError:
        return pointing(self._text, self._next.at, expected)
