"""Hostile values: what JSON, TOML and texts may hold where a program expects something sensible."""

import json
from copy import deepcopy
from random import Random
from typing import Any

__all__ = ["Values", "as_json", "torn"]

_DEEP = "\x02deep\x03"
_NUMBERS = (0, -1, 1, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, -(2**63) - 1, 2**64, 10**25, 10**400, 0.5, -0.0, 5e-324)
_FLOATS = (1e9, -1e9, 1e154, 1e300, -1e308, float("inf"), float("-inf"), float("nan"))
_TEXTS = ("", "\0", "a", "null", "../../etc/passwd", "/dev/zero", "\x1b[31mred\x1b[0m", "\u202e", "é" * 300, "n" * 70)
_MORE_TEXTS = ("x" * 10_000, "subprocess:Popen", "this:X", "a/b/c", "log/truth", "estimator/state", "journal/", ":")


class Values:
    """A source of hostile values, by its own stream of random numbers."""

    def __init__(self, random: Random) -> None:
        self.random = random

    def number(self) -> int | float:
        """Return a number, mostly at the edge of some range."""
        return self.random.choice((*_NUMBERS, *_FLOATS, self.random.uniform(-10, 10), self.random.randrange(300)))

    def text(self) -> str:
        """Return a text."""
        return self.random.choice((*_TEXTS, *_MORE_TEXTS))

    def value(self, depth: int = 2) -> Any:
        """Return any JSON value; ``as_json`` writes some of them as JSON that Python would not write."""
        kinds = ("number", "number", "text", "literal", "deep", "list", "table")
        match self.random.choice(kinds if depth else kinds[:5]):
            case "number":
                return self.number()
            case "text":
                return self.text()
            case "literal":
                return self.random.choice((None, True, False, [], {}, [[]]))
            case "deep":
                return _DEEP if self.random.random() < 0.05 else None
            case "list":
                return [self.value(depth - 1)] * self.random.choice((1, 2, 9, 9, 300 if depth > 1 else 9))
        return {self.text(): self.value(depth - 1) for _ in range(self.random.randrange(3))}

    def changed(self, document: Any) -> Any:
        """Return a JSON document with one or a few of its parts changed; another value where it would be huge."""
        changed = deepcopy(document)
        for _ in range(self.random.choice((1, 1, 1, 2, 5))):
            changed = self._changed_once(changed)
        return self.value() if _is_huge(changed) else changed

    def _changed_once(self, document: Any) -> Any:
        """Change one part of the document, found by a walk from its root that may stop anywhere."""
        if not isinstance(document, dict | list) or not document or self.random.random() < 0.02:
            return self.value()
        holder: Any = document
        while True:
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            key = self.random.choice(keys)
            inner = holder[key]
            if isinstance(inner, dict | list) and inner and self.random.random() < 0.8:
                holder = inner
                continue
            self._change(holder, key)
            return document

    def _change(self, holder: Any, key: Any) -> None:
        match self.random.choice(("replace", "replace", "nudge", "delete", "add", "repeat", "rename")):
            case "replace":
                holder[key] = self.value()
            case "nudge":
                inner = holder[key]
                if isinstance(inner, int | float) and not isinstance(inner, bool) and abs(inner) < 1e300:
                    holder[key] = inner * self.random.choice((-1, 2, 1e3, 1e-3, 1e9)) + self.random.choice((0, 1, -1))
                elif isinstance(inner, str):
                    holder[key] = self.text() + inner[: self.random.randrange(len(inner) + 1)]
            case "delete":
                del holder[key]
            case "add" if isinstance(holder, dict):
                holder[self.text()] = self.value()
            case "repeat" if isinstance(holder, list) and len(holder) < 100:
                holder[:] = holder * self.random.choice((2, 3, 50))
            case "rename" if isinstance(holder, dict):
                holder[self.random.choice((*holder, self.text()))] = holder.pop(key)


def _is_huge(value: Any) -> bool:
    """Return whether a document has more than 16 million characters: lists that are repeated may hold one another."""
    left, waiting = 2**24, [value]
    while waiting and left > 0:
        one = waiting.pop()
        left -= len(one) if isinstance(one, str) else 1
        if isinstance(one, dict | list):
            waiting += (*one, *one.values()) if isinstance(one, dict) else one
    return left <= 0


def as_json(value: Any) -> str:
    """Return a value as JSON: infinities as 1e400, and the first mark of depth as 100,000 nested lists."""
    text = json.dumps(value, ensure_ascii=False).replace("Infinity", "1e400")
    mark = json.dumps(_DEEP)
    return text.replace(mark, "[" * 100_000 + "]" * 100_000, 1).replace(mark, "null")


def torn(data: bytes, random: Random) -> bytes:
    """Return bytes with a few of them changed, cut off, put in or repeated."""
    found = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 4, 10))):
        if not found:
            break
        place = random.randrange(len(found))
        match random.choice(("flip", "word", "cut", "insert", "remove", "repeat")):
            case "flip":
                found[place] ^= 1 << random.randrange(8)
            case "word":
                word = random.choice(
                    (b"\0" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0" * 8, b"\xff" * 8)
                )
                found[place : place + len(word)] = word
            case "cut":
                del found[random.choice((place, len(found) - 1)) :]
            case "insert":
                found[place:place] = random.randbytes(random.choice((1, 2, 8)))
            case "remove":
                del found[place : place + random.choice((1, 2, 8, 100))]
            case "repeat":
                found[place:place] = found[place : place + random.choice((4, 50, 400))] * random.choice((1, 20))
    return bytes(found)
